"""The emulated moteus drives: registers, modes, torque, watchdog, and when they answer."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from dftc_rt.bus.frame import EFF_FLAG, FD_FRAME_SIZE, RTR_FLAG, frame_buffer, pack_fd, unpack
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import InputError
from hil.drive import slots
from hil.drive.moteus import MoteusDrives
from hil.drive.spec import DriveSpec
from tests.unit.drives.drive_bus import DriveBus
from tests.unit.drives.moteus.moteus_bus import bus_of, drives_of, scales, to

# Mode 10; position NaN and velocity 0; 6 Nm = 600 = 0258h; scales 0.
SIX_NM = "01000a 02208000 05225802 02230000"
STOP = "010000"
ASK = "11001d011602"  # mode as int8, position as float, velocity and torque as int16
TURN = 1 << 20  # encoder counts


def bus(n: int = 2, watchdog_s: float = 0.0, **sheet: object) -> DriveBus:
    return bus_of(drives_of(scales(n, **sheet), watchdog_s=watchdog_s))


def receive(drives: MoteusDrives, *frames: tuple[int, bytes]) -> None:
    """Hand frames over without taking the answers."""
    batch = frame_buffer(len(frames), FD_FRAME_SIZE)
    for row, (can_id, data) in enumerate(frames):
        batch[row] = np.frombuffer(pack_fd(can_id, data), dtype=np.uint8)
    assert drives.receive(0, batch, 0, len(frames)) == len(frames)


def answers(drives: MoteusDrives) -> list[tuple[int, bytes]]:
    """Return what the drives of the first bus say now."""
    out = frame_buffer(16, FD_FRAME_SIZE)
    return [unpack(out[row]) for row in range(drives.answer(0, out))]


def said(one: DriveBus, data: str, node: int = 1) -> str:
    """Return the data of a drive's answer, without NOPs at its end."""
    ((_, answer),) = one.exchange(to(node, data))
    return strip(answer)


def strip(answer: bytes) -> str:
    """Return data without NOPs at the end."""
    return answer.rstrip(b"\x50").hex()


def mode(one: DriveBus, node: int = 1) -> int:
    """Ask for the mode."""
    answer = said(one, "1100", node)
    assert answer[:4] == "2100"
    return int(answer[4:], 16)


# --- modes and torque ------------------------------------------------------------------


def test_torque_command() -> None:
    one = bus()
    found = one.exchange(to(2, SIX_NM + ASK))
    # Mode 10; position, velocity and torque 0: 15 bytes, and a NOP to have 16.
    assert found == [(0x200, bytes.fromhex("21000a 2d0100000000 260200000000 50"))]
    assert one.drives.command.tolist() == [0, 600]
    assert one.drives.operation_enabled.tolist() == [0, 1]
    assert one.drives.commands.tolist() == [0, 1]
    one.exchange(to(2, STOP))
    assert one.drives.command.tolist() == [0, 0]
    assert one.drives.operation_enabled.tolist() == [0, 0]


def test_only_who_asks_is_answered() -> None:
    one = bus()
    assert one.exchange((0x0001, bytes.fromhex(SIX_NM + ASK))) == []
    assert one.drives.command.tolist() == [600, 0]
    assert one.exchange(to(1, STOP)) == [(0x100, b"")]


def test_torque_is_limited() -> None:
    # 18 Nm = 1800 = 0708h, −18 Nm = F8F8h; at most 10 Nm by the drive, 5 Nm by register 0x025.
    one = bus(1, max_torque_nm=10.0)
    for torque, limit, expected in (
        ("0807", "", 1000), ("f8f8", "", -1000), ("0807", "0525f401", 500),
        ("0807", "0525d007", 1000),
    ):  # fmt: skip
        one.exchange(to(1, f"01000a 02208000 0522{torque} 02230000 {limit}"))
        assert one.drives.command.tolist() == [expected]


def test_what_a_command_leaves_out() -> None:
    # Position 0 and both scales 1: 4 Nm/rev · (0 − 0.25) rev − 0.05 Nm s/rev · 2 rev/s = −1.1 Nm.
    one = bus(1)
    one.drives.objects[0, [slots.POSITION, slots.VELOCITY]] = TURN // 4, 2 * TURN
    one.exchange(to(1, SIX_NM))
    one.exchange(to(1, "01000a"))
    assert one.drives.command.tolist() == [-110]
    # The scale of kd is at most that of kp, here 0: the torque alone.
    one.exchange(to(1, "01000a 052264 00 012300"))
    assert one.drives.command.tolist() == [100]


def test_registers_without_a_mode_are_kept_and_command_nothing() -> None:
    one = bus(1)
    assert said(one, "05225802 1d22") == "2d22" + struct.pack("<f", 6.0).hex()
    assert not one.drives.command.any()
    assert mode(one) == reg.STOPPED
    assert said(one, "01000a 1522") == "2522" + "0000"  # the mode begins anew


# --- watchdog and faults ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("timeout", "expires_s"),
    [("", 0.02), ("012700", 0.02), ("012705", 0.05), ("05272300", 0.035), ("012780", None)],
)
def test_watchdog(timeout: str, expires_s: float | None) -> None:
    one = bus(2, watchdog_s=0.02)
    drives = one.drives
    drives.tick(1.0)
    one.exchange(to(1, SIX_NM + timeout))
    drives.tick(1.0 + (expires_s or 100.0))
    assert drives.operation_enabled.tolist() == [1, 0]
    if expires_s is None:
        return
    assert mode(one) == reg.IN_POSITION  # and a question is no command
    drives.tick(1.0 + expires_s + 1e-6)
    assert drives.operation_enabled.tolist() == [0, 0]
    assert not drives.command.any()
    assert [mode(one, node) for node in (1, 2)] == [reg.TIMED_OUT, reg.STOPPED]
    one.exchange(to(1, SIX_NM))  # only a stop leads out of it
    assert mode(one) == reg.TIMED_OUT
    assert not drives.command.any()
    one.exchange(to(1, STOP), to(1, SIX_NM))
    assert mode(one) == reg.IN_POSITION
    assert drives.command.tolist() == [600, 0]


def test_fault_lasts_until_it_is_stopped_and_the_cause_gone() -> None:
    one = bus()
    one.exchange(to(1, SIX_NM), to(2, SIX_NM))
    one.drives.fault(0, 33)
    assert one.drives.command.tolist() == [0, 600]
    assert one.drives.operation_enabled.tolist() == [0, 1]
    one.exchange(to(1, SIX_NM))
    assert one.drives.command.tolist() == [0, 600]
    assert said(one, STOP + "1100110f") == "210001" + "210f21"
    one.drives.fault(0, 0)
    assert said(one, "1100110f") == "210001" + "210f21"
    assert said(one, STOP + "1100110f") == "210000" + "210f00"


# --- reading and errors ----------------------------------------------------------------


def test_state_in_every_format() -> None:
    one = bus(1)
    one.drives.objects[0, [slots.POSITION, slots.VELOCITY, slots.TORQUE_ACTUAL]] = (
        -TURN // 4, TURN // 2, 29,
    )  # fmt: skip
    # −0.25 rev, 0.5 rev/s, 0.29 Nm; integers are cut off.
    assert said(one, "1301") == "2301" + struct.pack("<3b", -25, 5, 0).hex()
    assert said(one, "1701") == "2701" + struct.pack("<3h", -2500, 2000, 29).hex()
    assert said(one, "1b01") == "2b01" + struct.pack("<3i", -25000, 50000, 290).hex()
    assert said(one, "1f01") == "2f01" + struct.pack("<3f", -0.25, 0.5, 0.29).hex()
    # 24 V by 0.5 V, 30 °C, no fault; with the count behind the first byte as well.
    assert said(one, "130d") == said(one, "10030d") == "230d301e00"


def test_positions_beyond_what_an_integer_holds() -> None:
    one = bus(1)
    one.drives.objects[0, slots.POSITION] = 5 * TURN
    assert said(one, "1501") == "2501ff7f"
    one.drives.objects[0, slots.POSITION] = -5 * TURN
    assert said(one, "1501") == "25010180"  # the most negative one is no position


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ("1108", "310801"),  # read: not there
        ("11ff03", "31ff0301"),  # 1FFh, as a varuint
        ("100407", "210700 310801 310901 210a1e"),  # of four, two are there
        ("011001", "301001"),  # write: not there
        ("010105", "300102"),  # only to be read
        ("010005", "300003"),  # a mode that they do not have
        ("010080", "300003"),
        ("0d000000c07f", "300003"),  # NaN
        ("010005 02220a0a 1100", "300003 210000"),
    ],
)
def test_errors(data: str, expected: str) -> None:
    one = bus(1)
    assert said(one, data) == expected.replace(" ", "")
    assert not one.drives.operation_enabled.any()
    assert not one.drives.command.any()


@pytest.mark.parametrize(
    "data", ["0522", "0c", "0480808080", "7f01", "01000a0522", "2c0e20", "00", "10"]
)
def test_frames_that_are_cut_off_or_make_no_sense(data: str) -> None:
    one = bus(1)
    assert len(one.exchange(to(1, data))) == 1
    assert not one.drives.command.any()
    assert mode(one) in (reg.STOPPED, reg.IN_POSITION)


def test_an_answer_is_64_bytes_at_most() -> None:
    # 14 floats are 59 bytes; what does not fit behind them is left out.
    one = bus(1)
    ((_, answer),) = one.exchange(to(1, "1c0e20 1c0e20 1100"))
    assert len(answer) == 64
    assert answer[:3].hex() == "2c0e20"
    assert strip(answer)[2 * 59 :] == ""


# --- who, and when ---------------------------------------------------------------------


def test_identifiers() -> None:
    drives = drives_of(scales(9), per_bus=9)
    one = bus_of(drives)
    found = one.exchange(to(1, "1100", host=3), to(9, "1100"), to(9, "1100", host=3))
    assert [can_id for can_id, _ in found] == [0x103, EFF_FLAG | 0x900, EFF_FLAG | 0x903]
    others = [0x8081, 0x1_8001, 0x800A, RTR_FLAG | 0x8001]
    assert one.exchange(*((EFF_FLAG | n, bytes.fromhex("1100")) for n in others)) == []


def test_answers_are_of_the_moment_of_the_answer() -> None:
    drives = bus(1).drives
    for data, starts in ((SIX_NM, (True, False)), (STOP, (False, True)), ("", (True, False))):
        drives.objects[0, slots.POSITION] = 0
        receive(drives, to(1, data + "1501"))
        assert (drives.synced, drives.switched) == starts
        drives.objects[0, slots.POSITION] = TURN // 4
        ((_, answer),) = answers(drives)
        assert strip(answer) == "2501c409"
    assert answers(drives) == []
    receive(drives, to(9, SIX_NM))  # nobody's
    assert (drives.synced, drives.switched) == (False, False)


def test_answers_are_in_the_order_of_the_frames() -> None:
    drives = bus(2).drives
    receive(drives, to(1, STOP))
    receive(drives, to(2, STOP))
    receive(drives, to(1, STOP))
    assert [can_id for can_id, _ in answers(drives)] == [0x100, 0x200, 0x100]
    assert drives.senders[:3].tolist() == [0, 1, 0]


def test_a_drive_off_the_bus_hears_nothing_and_owes_no_answer() -> None:
    drives = bus(2).drives
    receive(drives, to(1, SIX_NM), to(2, SIX_NM))
    drives.objects[0, slots.OFF_BUS] = slots.BUS_OFF
    receive(drives, to(1, STOP), to(2, STOP))
    assert [can_id for can_id, _ in answers(drives)] == [0x200, 0x200]
    assert drives.senders[:2].tolist() == [1, 1]
    assert drives.operation_enabled.tolist() == [1, 0]
    drives.objects[0, slots.OFF_BUS] = 0
    assert answers(drives) == []
    receive(drives, to(1, STOP))
    assert [can_id for can_id, _ in answers(drives)] == [0x100]


def test_drives_of_another_profile() -> None:
    sheet = JointScale(joint="a", counts_per_rev=1000, rated_torque_nm=1.0, max_torque_nm=2.0)
    with pytest.raises(InputError, match="moteus drives"):
        MoteusDrives([DriveSpec(1, 0, sheet)], 1)


def test_node_ids_that_are_taken() -> None:
    sheet = scales(1)[0]
    with pytest.raises(InputError, match="node id 1 is taken on bus 0"):
        MoteusDrives([DriveSpec(1, 0, sheet), DriveSpec(1, 0, sheet)], 1)
