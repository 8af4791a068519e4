"""PDOs of the emulated drives: transmission types, mapping, timing, against CiA 301."""

import struct

import numpy as np
import pytest

from dftc_rt.bus.frame import frame_buffer, pack
from hil.drive import slots
from hil.drive.node402 import Cia402Drives, DriveSpec
from tests.unit.drives.drive_bus import DriveBus, drives_of, read, scales, write

SYNC = (0x080, b"")
START_ALL = (0x000, b"\x01\x00")


def sync(counter: int) -> tuple[int, bytes]:
    return (0x080, bytes([counter]))


@pytest.fixture
def bus() -> DriveBus:
    return DriveBus(drives_of(scales(3)))


def remap(
    bus: DriveBus, node: int, comm: int, cob_id: int, entries: list[int], **rest: int
) -> None:
    """Remap a PDO by SDO, expecting every write to be accepted."""
    number = {"kind": (2, 1), "inhibit": (3, 2), "timer": (5, 2), "start": (6, 1)}
    assert write(bus, node, comm, 1, cob_id | 1 << 31, 4) == 0
    for name, value in rest.items():
        assert write(bus, node, comm, number[name][0], value, number[name][1]) == 0
    assert write(bus, node, comm + 0x200, 0, 0, 1) == 0
    for k, entry in enumerate(entries, start=1):
        assert write(bus, node, comm + 0x200, k, entry, 4) == 0
    assert write(bus, node, comm + 0x200, 0, len(entries), 1) == 0
    assert write(bus, node, comm, 1, cob_id, 4) == 0


def synchronous(bus: DriveBus, *nodes: int) -> None:
    """RPDO1 = controlword and target torque, TPDO1 = position and velocity, each SYNC."""
    for node in nodes:
        remap(bus, node, 0x1400, 0x200 + node, [0x60400010, 0x60710010], kind=1)
        remap(bus, node, 0x1800, 0x180 + node, [0x60640020, 0x606C0020], kind=1)


def switch_on(bus: DriveBus, *nodes: int) -> None:
    for node in nodes:
        assert write(bus, node, 0x6060, 0, 10, 1) == 0
        for word in (6, 7, 15):
            assert write(bus, node, 0x6040, 0, word, 2) == 0


def test_power_on_mapping_is_answered_at_once(bus: DriveBus) -> None:
    # Type 255: the controlword acts on reception; the statusword answers its change.
    # 0250h: switch on disabled (0040h), voltage enabled (0010h), remote (0200h).
    assert bus.exchange(START_ALL) == [(0x181 + k, b"\x50\x02") for k in range(3)]
    assert bus.exchange((0x202, b"\x06\x00")) == [(0x182, b"\x31\x02")]
    assert bus.exchange((0x202, b"\x07\x00")) == [(0x182, b"\x33\x02")]
    assert bus.exchange((0x202, b"\x0f\x00")) == [(0x182, b"\x37\x02")]
    assert bus.drives.operation_enabled.tolist() == [0, 1, 0]


def test_controlwords_of_one_batch_are_all_obeyed(bus: DriveBus) -> None:
    bus.exchange(START_ALL)
    bus.exchange((0x201, b"\x06\x00"), (0x201, b"\x07\x00"), (0x201, b"\x0f\x00"))
    assert bus.drives.enabled(0)


def test_synchronous_rpdo_acts_at_the_next_sync(bus: DriveBus) -> None:
    synchronous(bus, 1)
    switch_on(bus, 1)
    bus.exchange(START_ALL)
    bus.exchange((0x201, struct.pack("<Hh", 0x0F, 250)))
    assert bus.drives.command.tolist() == [0, 0, 0]
    bus.exchange(SYNC)
    assert bus.drives.command.tolist() == [250, 0, 0]
    assert bus.drives.commands.tolist() == [1, 0, 0]
    bus.exchange(SYNC)
    assert bus.drives.commands.tolist() == [1, 0, 0]  # nothing came, nothing is actuated


def test_torque_before_the_sync_of_one_batch_counts_and_after_it_waits(bus: DriveBus) -> None:
    synchronous(bus, 1)
    switch_on(bus, 1)
    bus.exchange(START_ALL)
    first, second = (struct.pack("<Hh", 0x0F, torque) for torque in (100, 200))
    bus.exchange((0x201, first), SYNC, (0x201, second))
    assert bus.drives.command[0] == 100
    bus.exchange(SYNC)
    assert bus.drives.command[0] == 200


def test_receive_stops_after_each_sync(bus: DriveBus) -> None:
    batch = frame_buffer(3)
    for row, frame in enumerate([(0x201, bytes(4)), SYNC, SYNC]):
        batch[row] = np.frombuffer(pack(*frame), dtype=np.uint8)
    drives = bus.drives
    assert (drives.receive(0, batch, 0, 3), drives.synced) == (2, True)
    assert (drives.receive(0, batch, 2, 3), drives.synced) == (3, True)
    assert (drives.receive(0, batch, 3, 3), drives.synced) == (3, False)


def test_feedback_bytes_in_node_order(bus: DriveBus) -> None:
    # Position −2 = FE FF FF FF; velocity 258 = 02 01 00 00. A count beyond int32 wraps:
    # 2³¹ + 5 = 80000005h.
    synchronous(bus, 3, 1, 2)
    bus.exchange(START_ALL)
    bus.drives.objects[:, slots.POSITION] = [-2, 2**31 + 5, 0]
    bus.drives.objects[:, slots.VELOCITY] = [258, 0, -1]
    assert bus.exchange(SYNC) == [
        (0x181, bytes.fromhex("feffffff 02010000")),
        (0x182, bytes.fromhex("05000080 00000000")),
        (0x183, bytes.fromhex("00000000 ffffffff")),
    ]
    assert bus.exchange() == []  # once per SYNC


def test_every_nth_sync(bus: DriveBus) -> None:
    remap(bus, 1, 0x1802, 0x381, [0x60770010], kind=3)
    bus.exchange(START_ALL)
    answered = [bool(bus.exchange(SYNC)) for _ in range(9)]
    assert answered == [False, False, True] * 3


def test_sync_start_value_staggers(bus: DriveBus) -> None:
    # CiA 301: the SYNC whose counter equals the start value counts as the first one, so
    # type 3 with start values 1, 2, 3 sends at counters 3, 4, 5, and every 3rd from there.
    for node in (1, 2, 3):
        remap(bus, node, 0x1802, 0x380 + node, [0x60770010], kind=3, start=node)
    bus.exchange(START_ALL)
    at = {0x381: [], 0x382: [], 0x383: []}
    for counter in [*range(1, 13), *range(1, 4)]:  # overflow 12
        for can_id, _ in bus.exchange(sync(counter)):
            at[can_id].append(counter)
    assert at == {0x381: [3, 6, 9, 12, 3], 0x382: [4, 7, 10, 1], 0x383: [5, 8, 11, 2]}


def test_lost_sync_does_not_shift_the_stagger(bus: DriveBus) -> None:
    remap(bus, 1, 0x1802, 0x381, [0x60770010], kind=3, start=1)
    bus.exchange(START_ALL)
    counters = [1, 2, 3, 5, 6, 7, 9]
    assert [c for c in counters if bus.exchange(sync(c))] == [3, 6, 9]


def test_sync_start_value_means_nothing_without_a_counter(bus: DriveBus) -> None:
    remap(bus, 1, 0x1802, 0x381, [0x60770010], kind=2, start=2)
    bus.exchange(START_ALL)
    assert [bool(bus.exchange(SYNC)) for _ in range(4)] == [False, True, False, True]


def test_acyclic_synchronous_comes_with_a_sync_when_something_changed(bus: DriveBus) -> None:
    remap(bus, 1, 0x1802, 0x381, [0x60770010], kind=0)
    bus.exchange(START_ALL)
    assert bus.exchange(SYNC) == [(0x381, b"\0\0")]
    assert bus.exchange(SYNC) == []
    bus.drives.objects[0, slots.TORQUE_ACTUAL] = -2
    assert bus.exchange() == []
    assert bus.exchange(SYNC) == [(0x381, b"\xfe\xff")]


def test_inhibit_time_is_rig_time(bus: DriveBus) -> None:
    remap(bus, 1, 0x1801, 0x281, [0x60410010, 0x60610008], kind=255, inhibit=100)  # 10 ms
    assert write(bus, 1, 0x1800, 1, 0x8000_0181, 4) == 0
    bus.drives.tick(1.0)
    assert (0x281, b"\x50\x02\x00") in bus.exchange(START_ALL)
    bus.drives.tick(1.0099)
    assert bus.exchange((0x201, b"\x06\x00")) == []
    bus.drives.tick(1.0100)
    assert bus.exchange() == [(0x281, b"\x31\x02\x00")]
    bus.drives.tick(2.0)
    assert bus.exchange() == []  # only changes are sent


def test_event_timer_repeats(bus: DriveBus) -> None:
    remap(bus, 1, 0x1801, 0x281, [0x60610008], kind=255, timer=20)
    bus.exchange(START_ALL)
    times = []
    for ms in range(1, 101):
        bus.drives.tick(ms * 1e-3)
        times += [ms for can_id, _ in bus.exchange() if can_id == 0x281]
    assert times == [20, 40, 60, 80, 100]


def test_rpdo_that_is_too_short_is_an_emergency(bus: DriveBus) -> None:
    # CiA 301: not processed, error 8210h; the register stays 0, since no fault is active.
    # A longer one is processed.
    bus.exchange(START_ALL)
    assert bus.exchange((0x201, b"\x06")) == [(0x081, bytes.fromhex("1082 00 0000000000"))]
    assert bus.drives.objects[0, slots.CONTROLWORD] == 0
    assert bus.exchange((0x201, b"\x06\x00\xff\xff")) == [(0x181, b"\x31\x02")]


def test_gap_in_the_mapping_is_skipped(bus: DriveBus) -> None:
    # A dummy (0006h, UNSIGNED16) in front of the controlword.
    remap(bus, 1, 0x1400, 0x201, [0x00060010, 0x60400010], kind=255)
    bus.exchange(START_ALL)
    bus.exchange((0x201, b"\xff\xff\x06\x00"))
    assert bus.drives.objects[0, slots.CONTROLWORD] == 6


def test_one_rpdo_for_several_drives(bus: DriveBus) -> None:
    for node in (1, 3):
        remap(bus, node, 0x1401, 0x345, [0x60400010], kind=255)
    bus.exchange(START_ALL)
    bus.exchange((0x345, b"\x06\x00"))
    assert bus.drives.objects[:, slots.CONTROLWORD].tolist() == [6, 0, 6]


@pytest.mark.parametrize("command", [0x80, 0x02])
def test_pdos_need_the_operational_state(bus: DriveBus, command: int) -> None:
    synchronous(bus, 1)
    bus.exchange(START_ALL)
    assert bus.exchange(SYNC)
    bus.exchange((0x201, bytes.fromhex("0600 1000")))
    bus.exchange((0x000, bytes([command, 0])))
    assert bus.exchange(SYNC) == []
    bus.exchange((0x201, bytes.fromhex("0600 1000")))
    bus.exchange(START_ALL)
    bus.exchange(SYNC)
    assert bus.drives.objects[0, slots.CONTROLWORD] == 0  # what was held is forgotten


def test_controlword_by_pdo_before_the_start_is_not_heard(bus: DriveBus) -> None:
    assert bus.exchange((0x201, b"\x06\x00")) == []
    assert bus.drives.objects[0, slots.CONTROLWORD] == 0


@pytest.mark.parametrize("flags", [0x8000_0000, 0x4000_0000, 0x2000_0000])
def test_remote_error_and_29_bit_frames_are_not_for_drives(bus: DriveBus, flags: int) -> None:
    bus.exchange(START_ALL)
    assert bus.exchange((0x201 | flags, b"\x06\x00"), (0x080 | flags, b"")) == []
    assert bus.drives.objects[0, slots.CONTROLWORD] == 0


def test_two_buses_are_apart() -> None:
    drives = drives_of(scales(2), per_bus=1)
    first, second = DriveBus(drives, 0), DriveBus(drives, 1)
    synchronous(first, 1)
    synchronous(second, 2)
    first.exchange(START_ALL)
    assert second.exchange(SYNC) == []
    second.exchange(START_ALL)
    assert [can_id for can_id, _ in second.exchange(SYNC)] == [0x182]
    first.exchange((0x202, bytes(4)))
    assert drives.objects[1, slots.RPDO_TIME] == -1


def test_torque_limit_is_the_drives_own(bus: DriveBus) -> None:
    synchronous(bus, 1)
    switch_on(bus, 1)
    write(bus, 1, 0x6072, 0, 300, 2)
    bus.exchange(START_ALL)
    bus.exchange((0x201, struct.pack("<Hh", 0x0F, -900)), SYNC)
    assert bus.drives.command[0] == -300
    assert bus.drives.objects[0, slots.STATUSWORD] & 1 << 11  # internal limit active


def test_torque_is_ignored_without_the_mode(bus: DriveBus) -> None:
    synchronous(bus, 1)
    switch_on(bus, 1)
    write(bus, 1, 0x6060, 0, 0, 1)
    bus.exchange(START_ALL)
    bus.exchange((0x201, struct.pack("<Hh", 0x0F, 500)), SYNC)
    assert bus.drives.enabled(0)
    assert bus.drives.command[0] == 0
    assert not bus.drives.objects[0, slots.STATUSWORD] & 1 << 12  # does not follow


def test_small_answer_buffer_loses_nothing_of_the_outbox() -> None:
    sheets = scales(3)
    drives = Cia402Drives([DriveSpec(i + 1, 0, s) for i, s in enumerate(sheets)], 1)
    out = frame_buffer(2)
    assert drives.answer(0, out) == 2
    assert drives.answer(0, out) == 1
    assert drives.answer(0, out) == 0


def test_read_helper_agrees(bus: DriveBus) -> None:
    assert read(bus, 1, 0x1400, 2) == 255
