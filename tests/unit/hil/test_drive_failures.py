"""What drives that fail show on the bus, frame by frame."""

from __future__ import annotations

import pytest

from dftc_rt.config.faults import EmcyFault, Fault, LateFault, RestartFault, SilentFault
from dftc_rt.config.load import load_scenario
from dftc_rt.drives.cia402 import states
from dftc_rt.errors import InputError
from hil import SCENARIOS
from hil.drive import slots
from hil.drive.failures import DriveFailures, check_failures
from tests.unit.drives.drive_bus import DriveBus, drives_of, read, scales, sdo_read, write

JOINTS = ("joint1", "joint2")
Frame = tuple[int, bytes]


class Line:
    """Two enabled drives at 1 kHz, RPDO3 and TPDO3 with every SYNC; one fails.

    The drives' position is the number of the cycle, so an answer tells when it was made.
    """

    def __init__(self, *faults: Fault) -> None:
        self.bus = DriveBus(drives_of(scales(2), watchdog_s=0.02))
        self.failures = DriveFailures(faults, JOINTS, self.bus.drives)
        self.k = 0
        for node in (1, 2):
            write(self.bus, node, 0x6060, 0, 10, 1)
            for index, cob_id in ((0x1402, 0x400 + node), (0x1802, 0x4000_0380 + node)):
                write(self.bus, node, index, 2, 1, 1)
                write(self.bus, node, index, 1, cob_id, 4)
        self.bus.exchange((0, b"\x01\x00"))
        for word in (6, 7, 15):
            self.command(word, 0)
        assert self.bus.drives.operation_enabled.all()

    def command(self, word: int, torque: int) -> list[Frame]:
        """Send commands and SYNC at the present time; return the answers."""
        data = word.to_bytes(2, "little") + torque.to_bytes(2, "little", signed=True)
        return self.bus.exchange((0x401, data), (0x402, data), (0x80, b""))

    def cycle(self, torque: int = 0) -> list[Frame]:
        """One more millisecond, then :meth:`command`."""
        self.k += 1
        self.failures.apply(self.k * 1e-3)
        self.bus.drives.tick(self.k * 1e-3)
        self.bus.drives.objects[:, slots.POSITION] = self.k
        return self.command(15, torque)


def position(k: int) -> bytes:
    return k.to_bytes(4, "little") + bytes(4)


def of(node: int, frames: list[Frame]) -> list[Frame]:
    return [frame for frame in frames if frame[0] & 0x7F == node]


def test_an_emergency_is_sent_once_and_its_cause_holds_the_fault() -> None:
    line = Line(EmcyFault(joint="joint2", start_s=0.003, end_s=0.006, error_code=0x4310))
    answers = [line.cycle() for _ in range(4)]
    emergencies = [[data for can_id, data in frames if can_id == 0x82] for frames in answers]
    # 4310h, temperature: bits 0 (generic) and 3 of the error register.
    assert emergencies == [[], [], [bytes.fromhex("1043090000000000")], []]
    assert line.bus.drives.operation_enabled.tolist() == [1, 0]
    assert read(line.bus, 2, 0x603F) == 0x4310
    assert read(line.bus, 2, 0x1003, 1) == 0x4310
    assert states.state_of(read(line.bus, 2, 0x6041)) == states.FAULT
    line.command(0, 0)
    line.command(0x80, 0)
    assert states.state_of(read(line.bus, 2, 0x6041)) == states.FAULT
    for _ in range(3):
        line.cycle()
    line.command(0, 0)
    assert (0x82, bytes(8)) in line.command(0x80, 0)
    assert states.state_of(read(line.bus, 2, 0x6041)) == states.SWITCH_ON_DISABLED


def test_a_silent_node_neither_sends_nor_hears() -> None:
    line = Line(SilentFault(joint="joint2", start_s=0.003, end_s=0.006))
    line.cycle(100)
    assert line.bus.drives.command.tolist() == [100, 100]
    assert of(2, line.cycle(100)) == [(0x382, position(2))]
    for k in (3, 4, 5):
        frames = line.cycle(-200)
        assert (0x381, position(k)) in frames
        assert of(2, frames) == []
        assert line.bus.drives.command.tolist() == [-200, 100]  # it goes on as it was told
        assert line.bus.exchange((0x602, sdo_read(0x1000, 0)), (0, b"\x02\x02")) == []
    assert of(2, line.cycle(-200)) == [(0x382, position(6))]
    assert line.bus.drives.command.tolist() == [-200, -200]
    assert line.bus.drives.objects[1, slots.NMT] == 5  # "stop" was not heard


def test_silence_longer_than_the_watchdog_is_a_fault_that_nobody_hears_of() -> None:
    line = Line(SilentFault(joint="joint2", start_s=0.003, end_s=0.050))
    frames = [frame for _ in range(49) for frame in line.cycle()]
    assert 0x82 not in {can_id for can_id, _ in frames}
    assert line.bus.drives.operation_enabled.tolist() == [1, 0]
    word = dict(of(2, line.cycle()))[0x182]
    assert states.state_of(int.from_bytes(word, "little")) == states.FAULT
    assert read(line.bus, 2, 0x603F) == 0x8250


def test_late_answers_come_in_order_and_say_what_was() -> None:
    line = Line(LateFault(joint="joint2", start_s=0.003, end_s=0.008, delay_s=0.002))
    seen = {k: [data for can_id, data in line.cycle() if can_id == 0x382] for k in range(1, 13)}
    assert seen[2] == [position(2)]
    assert seen[3] == seen[4] == []
    assert [seen[k] for k in (5, 6, 7)] == [[position(3)], [position(4)], [position(5)]]
    # On time again from 8 on, but behind what waits.
    assert seen[8] == [position(6)]
    assert seen[9] == [position(7), position(8), position(9)]
    assert [seen[k] for k in (10, 11)] == [[position(10)], [position(11)]]


def test_late_holds_for_sdo_too_and_for_no_other_node() -> None:
    line = Line(LateFault(joint="joint2", start_s=0.001, delay_s=0.003))
    line.cycle()
    line.bus.take()
    assert line.bus.exchange((0x602, sdo_read(0x6061, 0))) == []
    assert read(line.bus, 1, 0x6061) == 10
    found = [of(2, line.cycle()) for _ in range(3)]
    assert (0x582, bytes.fromhex("4f6160000a000000")) in found[2]
    assert found[:2] == [[], []]


def test_a_restart_loses_the_state_and_ends_with_a_boot_up_message() -> None:
    line = Line(RestartFault(joint="joint2", start_s=0.003, boot_s=0.004))
    line.cycle()
    line.cycle()
    for _ in range(4):
        assert of(2, line.cycle()) == []
        assert line.bus.drives.operation_enabled.tolist() == [1, 0]  # its brake closes at once
    assert of(2, line.cycle()) == [(0x702, b"\0")]
    assert of(2, line.cycle()) == []  # pre-operational: no PDOs
    assert line.bus.drives.objects[:, slots.NMT].tolist() == [5, 127]
    assert read(line.bus, 2, 0x6060) == 0
    assert read(line.bus, 2, 0x1802, 1) == 0xC000_0382  # not valid, as after power-on
    assert states.state_of(read(line.bus, 2, 0x6041)) == states.SWITCH_ON_DISABLED
    assert read(line.bus, 1, 0x6060) == 10


@pytest.mark.parametrize(
    ("fault", "where"),
    [
        ('kind="emcy"', "error_code"),
        ('kind="emcy", error_code=65536', "error_code"),
        ('kind="late", delay_s=0', "delay_s"),
        ('kind="restart", end_s=2.0', "end_s"),
        ('kind="restart", boot_s=-1', "boot_s"),
        ('kind="silent", duration=1', "duration"),
        ('kind="lock", bits=1', "bits"),
        ('kind="sensor_bits", bits=0', "bits"),
        ('kind="sensor_bias"', "bias_rad"),
        ('kind="sensor_noise", position_rad=-1e-3', "position_rad"),
    ],
)
def test_a_wrong_key_is_named_in_one_line(fault: str, where: str) -> None:
    settings = [f'fault=[{{joint="panda_joint2", {fault}}}]']
    with pytest.raises(InputError, match=where) as refused:
        load_scenario("panda_shoulder_loss", settings, SCENARIOS)
    assert "\n" not in str(refused.value)


def test_drives_without_canopen_cannot_fail_so() -> None:
    fault = LateFault(joint="joint1", delay_s=0.01)
    with pytest.raises(InputError, match=r"fault\[0\].kind: 'late' with .*'mit'"):
        check_failures([fault], "mit")
    check_failures([fault], "cia402")
