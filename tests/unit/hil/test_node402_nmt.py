"""NMT, heartbeats, emergencies, faults and lost connections of the emulated drives."""

import struct

import pytest

from dftc_rt.bus.frame import frame_buffer, unpack
from dftc_rt.drives.cia402 import states as s
from dftc_rt.errors import InputError
from hil.drive import slots
from hil.drive.node402 import Cia402Drives, DriveSpec
from tests.unit.drives.drive_bus import DriveBus, drives_of, read, scales, write

START, STOP, PRE, RESET, RESET_COMM = (bytes([c, 0]) for c in (1, 2, 128, 129, 130))


def live(**spec: float) -> DriveBus:
    """Return a bus with one drive in operation, at t = 0."""
    bus = DriveBus(drives_of(scales(1), **spec))
    bus.exchange((0, START))
    write(bus, 1, 0x6060, 0, 10, 1)
    bus.exchange((0x201, b"\x06\x00"), (0x201, b"\x07\x00"), (0x201, b"\x0f\x00"))
    assert bus.drives.enabled(0)
    return bus


def service(bus: DriveBus, t: float) -> list[tuple[int, bytes]]:
    bus.drives.tick(t)
    return bus.exchange()


def test_boot_up_message() -> None:
    drives = Cia402Drives([DriveSpec(7, 0, scales(1)[0])], 1)
    out = frame_buffer(4)
    assert drives.answer(0, out) == 1
    assert unpack(out[0]) == (0x707, b"\0")
    assert drives.objects[0, slots.NMT] == 127
    assert drives.state[0] == s.SWITCH_ON_DISABLED


def test_nmt_states_and_addressing() -> None:
    bus = DriveBus(drives_of(scales(2)))
    for command, state in ((1, 5), (128, 127), (2, 4)):
        bus.exchange((0, bytes([command, 2])))
        assert bus.drives.objects[:, slots.NMT].tolist() == [127, state]
    bus.exchange((0, bytes([1, 0])))
    assert bus.drives.objects[:, slots.NMT].tolist() == [5, 5]
    bus.exchange((0, bytes([99, 0])), (0, b"\x01"))  # unknown; too short
    assert bus.drives.objects[:, slots.NMT].tolist() == [5, 5]


def test_no_sdo_while_stopped() -> None:
    bus = DriveBus(drives_of(scales(1)))
    bus.exchange((0, STOP))
    assert bus.exchange((0x601, bytes.fromhex("40001000 00000000"))) == []


def test_reset_node_restores_power_on_defaults() -> None:
    bus = live()
    bus.drives.objects[0, slots.POSITION] = 77
    write(bus, 1, 0x605A, 0, 6, 2)
    write(bus, 1, 0x1017, 0, 10, 2)
    write(bus, 1, 0x1800, 1, 0x8000_0181, 4)
    assert bus.exchange((0, RESET)) == [(0x701, b"\0")]
    assert read(bus, 1, 0x605A) == 2
    assert read(bus, 1, 0x1017) == 0
    assert read(bus, 1, 0x1800, 1) == 0x4000_0181
    assert read(bus, 1, 0x6060) == 0
    assert read(bus, 1, 0x6064) == 77  # the shaft did not move
    assert bus.drives.state[0] == s.SWITCH_ON_DISABLED
    assert service(bus, 1.0) == []


def test_reset_communication_keeps_the_drive_profile() -> None:
    bus = live()
    write(bus, 1, 0x6040, 0, 7, 2)
    write(bus, 1, 0x605A, 0, 6, 2)
    write(bus, 1, 0x1006, 0, 500, 4)
    assert bus.exchange((0, RESET_COMM)) == [(0x701, b"\0")]
    assert read(bus, 1, 0x1006) == 0
    assert read(bus, 1, 0x605A) == 6
    assert bus.drives.state[0] == s.SWITCHED_ON


def test_heartbeat_carries_the_state_in_rig_time() -> None:
    bus = DriveBus(drives_of(scales(2)))
    for node in (1, 2):
        write(bus, node, 0x1017, 0, 100, 2)
    seen = {}
    for ms in range(1, 311):
        bus.drives.tick(ms * 1e-3)
        if ms == 150:
            bus.exchange((0, START))
        for can_id, data in bus.exchange():
            if can_id > 0x700:
                seen[ms] = (can_id, data[0])
    # Every 100 ms, a millisecond apart per node id; operational (5) after the start.
    assert seen == {
        101: (0x701, 127), 102: (0x702, 127), 201: (0x701, 5), 202: (0x702, 5),
        301: (0x701, 5), 302: (0x702, 5),
    }  # fmt: skip
    write(bus, 1, 0x1017, 0, 0, 2)
    write(bus, 2, 0x1017, 0, 0, 2)
    assert service(bus, 9.0) == []


def test_heartbeat_that_is_late_is_sent_once() -> None:
    bus = DriveBus(drives_of(scales(1)))
    write(bus, 1, 0x1017, 0, 10, 2)
    assert len(service(bus, 1.0)) == 1
    assert len(service(bus, 1.001)) <= 1


def test_fault_bytes_and_way_back() -> None:
    # 2310h continuous over-current: 10 23; register: generic and current, 03; then the
    # statusword 0218h (fault 0008h, voltage 0010h, remote 0200h).
    bus = live()
    bus.drives.fault(0, 0x2310)
    assert bus.drives.state[0] == s.FAULT_REACTION_ACTIVE
    assert not bus.drives.command.any()
    assert service(bus, 0.001) == [
        (0x181, b"\x18\x02"), (0x081, bytes.fromhex("1023 03 0000000000")),
    ]  # fmt: skip
    assert read(bus, 1, 0x603F) == 0x2310
    assert read(bus, 1, 0x1001) == 0x03
    bus.exchange((0x201, b"\x0f\x00"))
    assert bus.drives.state[0] == s.FAULT
    # Reset: rising edge of bit 7; emergency 0000h, register 0; switch on disabled.
    assert bus.exchange((0x201, b"\x80\x00")) == [
        (0x181, b"\x50\x02"), (0x081, bytes(8)),
    ]  # fmt: skip
    assert read(bus, 1, 0x603F) == 0


def test_lasting_cause_refuses_the_reset() -> None:
    bus = live()
    bus.drives.fault(0, 0x4310, lasting=True)
    service(bus, 0.001)
    bus.exchange((0x201, b"\x80\x00"))
    assert bus.drives.state[0] == s.FAULT
    bus.drives.clear_cause(0)
    bus.exchange((0x201, b"\x80\x00"))
    assert bus.drives.state[0] == s.FAULT  # no edge
    bus.exchange((0x201, b"\x00\x00"), (0x201, b"\x80\x00"))
    assert bus.drives.state[0] == s.SWITCH_ON_DISABLED


def test_fault_reaction_that_brakes_lasts_until_standstill() -> None:
    bus = live()
    write(bus, 1, 0x605E, 0, 2, 2)
    bus.drives.objects[0, slots.VELOCITY] = 100_000
    bus.drives.fault(0, 0x2310)
    service(bus, 0.001)
    assert bus.drives.state[0] == s.FAULT_REACTION_ACTIVE
    bus.drives.objects[0, slots.VELOCITY] = 0
    service(bus, 0.002)
    assert bus.drives.state[0] == s.FAULT


@pytest.mark.parametrize(("option", "state"), [(0, 1), (2, 5), (6, 5)])
def test_quick_stop_options_while_moving(option: int, state: int) -> None:
    bus = live()
    write(bus, 1, 0x605A, 0, option, 2)
    bus.drives.objects[0, slots.VELOCITY] = 100_000
    bus.exchange((0x201, b"\x02\x00"))
    assert bus.drives.state[0] == s.QUICK_STOP_ACTIVE
    service(bus, 0.001)
    assert bus.drives.state[0] == state
    bus.drives.objects[0, slots.VELOCITY] = 0
    service(bus, 0.002)
    assert bus.drives.state[0] == (s.QUICK_STOP_ACTIVE if option == 6 else s.SWITCH_ON_DISABLED)


def watched(option: int, behaviour: int) -> DriveBus:
    bus = live()
    write(bus, 1, 0x6007, 0, option, 2)
    write(bus, 1, 0x1029, 1, behaviour, 1)
    write(bus, 1, 0x1016, 1, 127 << 16 | 50, 4)
    bus.drives.objects[0, slots.VELOCITY] = 100_000
    return bus


@pytest.mark.parametrize(
    ("option", "state"),
    [
        (0, s.OPERATION_ENABLED),  # no action
        (1, s.FAULT_REACTION_ACTIVE),
        (2, s.SWITCH_ON_DISABLED),
        (3, s.QUICK_STOP_ACTIVE),
    ],
)
@pytest.mark.parametrize(("behaviour", "nmt"), [(0, 127), (1, 5), (2, 4)])
def test_lost_heartbeat(option: int, state: int, behaviour: int, nmt: int) -> None:
    bus = watched(option, behaviour)
    service(bus, 5.0)
    assert bus.drives.enabled(0)  # not watched before the first heartbeat
    bus.exchange((0x77F, b"\x05"))
    service(bus, 5.040)
    bus.exchange((0x77E, b"\x05"), (0x77F, b"\x05"))
    service(bus, 5.090)
    assert bus.drives.enabled(0)
    answers = service(bus, 5.091)
    assert bus.drives.state[0] == state
    assert bus.drives.objects[0, slots.NMT] == nmt
    codes = [struct.unpack_from("<H", data)[0] for can_id, data in answers if can_id == 0x081]
    assert codes == [0x8130]


def test_other_nodes_heartbeats_do_not_count() -> None:
    bus = watched(1, 1)
    bus.exchange((0x77F, b"\x05"))
    bus.drives.tick(0.04)
    bus.exchange((0x77E, b"\x05"))
    bus.drives.tick(0.06)
    assert not bus.drives.enabled(0)


def test_each_drive_watches_its_own_producer() -> None:
    bus = DriveBus(drives_of(scales(2)))
    for node, producer in ((1, 127), (2, 126)):
        write(bus, node, 0x1016, 1, producer << 16 | 50, 4)
    bus.exchange((0x77F, b"\x05"), (0x77E, b"\x05"))
    bus.drives.tick(0.04)
    bus.exchange((0x77E, b"\x05"))
    bus.drives.tick(0.06)
    assert bus.drives.state.tolist() == [s.FAULT_REACTION_ACTIVE, s.SWITCH_ON_DISABLED]


def test_watchdog_counts_rig_time_between_rpdos() -> None:
    bus = live(watchdog_s=0.02)
    bus.drives.tick(0.020)
    assert bus.drives.enabled(0)
    bus.exchange((0x201, b"\x0f\x00"))
    bus.drives.tick(0.040)
    assert bus.drives.enabled(0)
    answers = service(bus, 0.0401)
    assert bus.drives.state[0] == s.FAULT_REACTION_ACTIVE
    # 8250h RPDO timeout: 50 82; register: generic and communication, 11.
    assert (0x081, bytes.fromhex("5082 11 0000000000")) in answers


def test_rpdo_event_timer_takes_the_watchdogs_place() -> None:
    bus = live(watchdog_s=0.02)
    assert write(bus, 1, 0x1400, 5, 500, 2) == 0
    bus.drives.tick(0.4)
    assert bus.drives.enabled(0)
    bus.drives.tick(0.6)
    assert not bus.drives.enabled(0)


@pytest.mark.parametrize("command", [STOP, RESET_COMM])
def test_nmt_that_cuts_the_connection_stops_the_drive(command: bytes) -> None:
    bus = live()
    bus.exchange((0, command))
    assert bus.drives.state[0] == s.FAULT_REACTION_ACTIVE


@pytest.mark.parametrize(
    ("specs", "what"),
    [
        ([(0, 0)], "node id 0"),
        ([(127, 0)], "node id 127"),  # the controller's
        ([(1, 1)], "bus 1"),
        ([(1, 0), (1, 0)], "node id 1 is taken on bus 0"),
    ],
)
def test_bad_wiring(specs: list[tuple[int, int]], what: str) -> None:
    sheet = scales(1)[0]
    with pytest.raises(InputError, match=what):
        Cia402Drives([DriveSpec(node, bus, sheet) for node, bus in specs], 1)


def test_every_object_that_kernels_hold_is_one_a_drive_can_know() -> None:
    # The drive's matrix has no column for an effectiveness, a true position or a fault.
    names = {name for name in vars(slots) if name.isupper()}
    assert not {n for n in names if "RHO" in n or "TRUE" in n or "EFFECTIVE" in n}
    assert slots.N_OBJECTS == 29
