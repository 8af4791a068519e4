"""Set-up of emulated drives through canopen, in lock-step and without threads."""

import threading
import time

import numpy as np
import pytest

from dftc_rt.drives.cia402 import states
from dftc_rt.drives.cia402.client import Cia402Client, _interpolation_period
from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import BusError, DriveError, InputError
from hil.drive import slots
from tests.unit.drives.drive_bus import DriveBus, configs, drives_of, read, scales, write

pytestmark = pytest.mark.realtime


def rig(n: int = 4, wakes: bool = False, **spec: float):
    drives = drives_of(scales(n), **spec)
    buses = [DriveBus(drives, bus, wakes) for bus in range((n - 1) // 3 + 1)]
    return drives, buses


def client(buses: list[DriveBus], n: int = 4, **options: float) -> Cia402Client:
    return Cia402Client(buses, configs(scales(n)), 1000.0, **options)


@pytest.mark.parametrize("wakes", [False, True])
def test_configure_leaves_drives_switched_on_and_no_thread(wakes: bool) -> None:
    drives, buses = rig(wakes=wakes)
    drives.objects[:, slots.POSITION] = [5, -6, 7, -8]
    before = threading.active_count()
    found = client(buses).configure()
    assert threading.active_count() == before
    assert drives.state.tolist() == [states.SWITCHED_ON] * 4
    assert [states.state_of(word) for word in found.statusword] == [states.SWITCHED_ON] * 4
    assert found.counts.tolist() == [5, -6, 7, -8]
    for bus in buses:
        bus.close()


def test_configure_writes_what_the_cycle_needs() -> None:
    _, buses = rig()
    client(buses).configure()
    bus = buses[0]
    for index, sub, value in (
        (0x6060, 0, 10),  # cyclic synchronous torque
        (0x60C2, 1, 1),
        (0x60C2, 2, 0xFD),  # 1 · 10^-3 s
        (0x1006, 0, 1000),  # µs
        (0x1019, 0, 240),
        (0x6072, 0, 2000),  # 100 of 50 Nm, per mille
        (0x6071, 0, 0),
        (0x605A, 0, 2),
        (0x6007, 0, 1),
        (0x1029, 1, 1),
        (0x1016, 1, 127 << 16 | 150),
        (0x1017, 0, 100),
        (0x1400, 2, 1),
        (0x1800, 2, 1),
        (0x1801, 2, 255),
        (0x1802, 2, 10),
    ):
        assert read(bus, 2, index, sub) == value, f"{index:04X}h:{sub}"
    assert read(bus, 2, 0x1401, 1) & 1 << 31
    assert read(bus, 2, 0x1803, 1) & 1 << 31
    assert [read(bus, node, 0x1802, 6) for node in (1, 2, 3)] == [1, 2, 3]


def test_configure_twice_and_from_any_state() -> None:
    drives, buses = rig()
    client(buses).configure()
    drives.objects[0, slots.STATE] = states.OPERATION_ENABLED
    drives.objects[1, slots.STATE] = states.QUICK_STOP_ACTIVE
    drives.objects[1, slots.VELOCITY] = 1_000_000  # still turning
    drives.fault(2, 0x2310)
    drives.tick(0.0)  # fault reaction over
    assert drives.state.tolist() == [
        states.OPERATION_ENABLED, states.QUICK_STOP_ACTIVE, states.FAULT, states.SWITCHED_ON,
    ]  # fmt: skip
    client(buses).configure()
    assert drives.state.tolist() == [states.SWITCHED_ON] * 4
    assert read(buses[0], 3, 0x603F) == 0


def test_same_frames_every_time() -> None:
    sent = []
    for _ in range(2):
        _, buses = rig()
        client(buses).configure()
        sent.append([bus.sent for bus in buses])
    assert sent[0] == sent[1]


def test_lasting_fault_is_one_line() -> None:
    drives, buses = rig()
    drives.fault(1, 0x3210, lasting=True)
    drives.tick(0.0)
    with pytest.raises(DriveError) as error:
        client(buses).configure()
    assert str(error.value) == "joint2 (node 2 on can0): fault 603Fh 0x3210 cannot be reset"
    drives.clear_cause(1)
    client(buses).configure()
    assert drives.state.tolist() == [states.SWITCHED_ON] * 4


@pytest.mark.parametrize("wakes", [False, True])
def test_missing_drive_is_one_line_in_bounded_time(
    wakes: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    _, buses = rig(wakes=wakes)
    buses[1].deaf = True
    with pytest.raises(DriveError) as error:
        client(buses, timeout_s=0.02).configure()
    assert str(error.value) == "joint4 (node 4 on can1): no answer to SDO within 0.02 s"
    assert (error.value.joint, error.value.node_id, error.value.bus) == ("joint4", 4, "can1")
    assert capsys.readouterr() == ("", "")
    for bus in buses:
        bus.close()


def test_in_process_there_is_nothing_to_wait_for() -> None:
    # The other side has run when send returns: an hour's patience is not used up.
    _, buses = rig(1)
    buses[0].deaf = True
    with pytest.raises(DriveError, match="no answer to SDO"):
        client(buses, 1, timeout_s=3600.0).configure()


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (
            {"rated_torque_nm": 60.0},
            "rated torque 6076h is 60000 mNm, the robot file says 50000 mNm",
        ),
        ({"counts_per_rev": 4096}, "encoder resolution 608Fh is 4096 counts/rev"),
        ({"gear": 50.0}, "gear ratio 6091h is 50"),
    ],
)
def test_drive_that_is_not_the_robot_files(change: dict[str, float], what: str) -> None:
    sheets = scales(2)
    sheets[1] = scales(2, **change)[1]
    drives = drives_of(sheets)
    with pytest.raises(DriveError, match=rf"^joint2 \(node 2 on can0\): {what}"):
        Cia402Client([DriveBus(drives)], configs(scales(2)), 1000.0).configure()


class Pretender(DriveBus):
    """Answers reads of one object with a value of the test's choosing."""

    lie: tuple[int, int] = (0, 0)

    def receive(self, frames) -> int:
        count = super().receive(frames)
        for row in range(count):
            data = frames[row, 8:16]
            if frames[row, 1] == 5 and int.from_bytes(bytes(data[1:3]), "little") == self.lie[0]:
                data[4:8] = list(self.lie[1].to_bytes(4, "little"))
        return count


@pytest.mark.parametrize(
    ("index", "value", "what"),
    [
        (0x1000, 0x0002_0191, "device type 1000h is 0x00020191, not a CiA 402 drive"),
        (0x6502, 0x0000_0080, "supported modes 6502h are 0x80: no cyclic synchronous torque"),
        (0x6061, 0, "mode display 6061h is 0 after mode 10 was set"),
        (0x6041, 0x0000, "is in state 'not ready to switch on' after disable voltage"),
    ],
)
def test_wrong_device(index: int, value: int, what: str) -> None:
    bus = Pretender(drives_of(scales(1)))
    bus.lie = (index, value)
    with pytest.raises(DriveError) as error:
        Cia402Client([bus], configs(scales(1)), 1000.0).configure()
    assert error.value.what == what


def test_refused_setting_names_object_and_reason() -> None:
    drives = drives_of(scales(1))
    bus = DriveBus(drives)
    unlimited = JointScale("joint1", 1000, 50.0, 100.0, gear=100.0)
    # A rate of 2 MHz gives 0 µs, which the interpolation period cannot say (at least 1).
    with pytest.raises(DriveError, match="refused object 60C2h:01h := 0: Code 0x06090032"):
        Cia402Client([bus], configs([unlimited]), 4e6).configure()


def test_two_drives_on_one_node_id() -> None:
    drives, buses = rig(2)
    twice = configs(scales(2))
    with pytest.raises(InputError, match="node id 1 is taken on can0"):
        Cia402Client(buses, [twice[0], twice[0]], 1000.0)
    del drives


def test_shutdown_takes_power_off_and_names_the_silent() -> None:
    drives, buses = rig()
    master = client(buses, timeout_s=0.02)
    master.configure()
    assert master.shutdown() == ()
    assert drives.state.tolist() == [states.SWITCH_ON_DISABLED] * 4
    assert drives.objects[:, slots.NMT].tolist() == [127] * 4
    buses[1].deaf = True
    assert master.shutdown() == ("joint4",)


def test_bus_that_takes_nothing() -> None:
    class Full(DriveBus):
        def send(self, frames, count: int) -> int:
            return 0

    with pytest.raises(BusError, match="can0: takes no frames"):
        Cia402Client([Full(drives_of(scales(1)))], configs(scales(1)), 1000.0).configure()


def test_set_up_takes_no_rig_time(monkeypatch: pytest.MonkeyPatch) -> None:
    # Success must not depend on a clock: one that stands still changes nothing.
    monkeypatch.setattr(time, "monotonic", lambda: 0.0)
    drives, buses = rig()
    client(buses).configure()
    assert drives.state.tolist() == [states.SWITCHED_ON] * 4


def test_watch_on_the_master_starts_with_its_first_heartbeat() -> None:
    drives, buses = rig(1)
    client(buses, 1).configure()
    drives.tick(10.0)
    assert drives.state.tolist() == [states.SWITCHED_ON]
    buses[0].exchange((0x77F, b"\x05"))
    drives.tick(10.2)
    assert drives.state.tolist() == [states.FAULT_REACTION_ACTIVE]


@pytest.mark.parametrize(
    ("period_us", "expected"),
    [(1000, (1, -3)), (500, (5, -4)), (250, (25, -5)), (4000, (4, -3)), (1250, (125, -5)),
     (333, (33, -5)), (10_000, (1, -2))],
)  # fmt: skip
def test_interpolation_period(period_us: int, expected: tuple[int, int]) -> None:
    assert _interpolation_period(period_us) == expected


def test_write_helper_sees_aborts() -> None:
    # The helper that other tests lean on: 6041h is read-only, abort 0601 0002h.
    _, buses = rig(1)
    assert write(buses[0], 1, 0x6041, 0, 0, 2) == 0x0601_0002
    assert np.array_equal(buses[0].sent[-1][1][:4], b"\x2b\x41\x60\x00")
