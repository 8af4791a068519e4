"""Set-up of MIT drives: who answers, where it is, and one line for what is wrong."""

from __future__ import annotations

import time

import numpy as np
import pytest

from dftc_rt.bus.frame import pack
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.mit.client import MitClient
from dftc_rt.errors import BusError, DriveError, InputError
from hil.drive import slots
from tests.unit.drives.drive_bus import DriveBus
from tests.unit.drives.mit.mit_bus import configs, drives_of, scales

LEAVE = bytes.fromhex("fffffffffffffffd")
RADIAN = (1 << 20) / (2 * np.pi)  # encoder counts


def rig(n: int = 4, wakes: bool = False, **sheet: object):
    drives = drives_of(scales(n, **sheet))
    return drives, [DriveBus(drives, bus, wakes) for bus in range((n - 1) // 3 + 1)]


def client(buses: list[DriveBus], n: int = 4, timeout_s: float = 1.0, **sheet: object) -> MitClient:
    return MitClient(buses, configs(scales(n, **sheet)), 1000.0, timeout_s)


def refusal(buses: list[DriveBus], n: int = 4, **sheet: object) -> str:
    with pytest.raises(DriveError) as error:
        client(buses, n, timeout_s=0.02, **sheet).configure()
    return str(error.value)


@pytest.mark.parametrize("wakes", [False, True])
def test_configure_finds_every_drive_at_rest(wakes: bool) -> None:
    drives, buses = rig(wakes=wakes)
    drives.objects[:, slots.ENABLED] = 1  # left in motor mode by a controller before this one
    drives.objects[:, slots.POSITION] = np.array([1.0, -2.0, 3.0, -4.0]) * RADIAN
    found = client(buses).configure()
    assert not drives.operation_enabled.any()
    assert [states.state_of(word) for word in found.statusword] == [states.SWITCHED_ON] * 4
    # (1 + 12.5) · 65535 / 25 = 35388.9, (−2 + 12.5) … = 27524.7, 40631.7, 22281.9: cut off.
    assert found.counts.tolist() == [35388, 27524, 40631, 22281]
    assert buses[0].sent == [(node, LEAVE) for node in (1, 1, 2, 2, 3, 3)]
    assert buses[1].sent == [(4, LEAVE)] * 2
    assert not any(bus.take() for bus in buses)  # nothing is left for the loop
    for bus in buses:
        bus.close()


@pytest.mark.parametrize("answer_bytes", [6, 8])
@pytest.mark.parametrize("host_id", [0, 0x100])
def test_both_lengths_of_answer_and_any_host_id(answer_bytes: int, host_id: int) -> None:
    _, buses = rig(answer_bytes=answer_bytes, host_id=host_id)
    assert client(buses, host_id=host_id).configure().counts.tolist() == [32767] * 4


@pytest.mark.parametrize("wakes", [False, True])
def test_missing_drive(wakes: bool) -> None:
    _, buses = rig(wakes=wakes)
    buses[1].deaf = True
    line = "joint4 (node 4 on can1): no answer to 'leave motor mode' within 0.02 s"
    assert refusal(buses) == line
    for bus in buses:
        bus.close()


class Renumbered(DriveBus):
    """Drives that say another node id in their answers."""

    def receive(self, frames) -> int:
        count = super().receive(frames)
        frames[:count, 8] += 6
        return count


def test_wrong_node_id_in_the_answer() -> None:
    drives, _ = rig(1)
    line = "joint1 (node 1 on can0): no answer to 'leave motor mode' within 0.02 s; heard node 7"
    assert refusal([Renumbered(drives)], 1) == line


def test_wrong_host_id() -> None:
    _, buses = rig(1, host_id=0x55)
    line = (
        "joint1 (node 1 on can0): no answer to 'leave motor mode' within 0.02 s; "
        "heard identifier 0x55"
    )
    assert refusal(buses, 1) == line


def test_answer_that_is_too_short() -> None:
    class Short(DriveBus):
        def receive(self, frames) -> int:
            count = super().receive(frames)
            frames[:count, 4] = 5
            return count

    drives, _ = rig(1)
    assert refusal([Short(drives)], 1).endswith("; heard an answer of 5 bytes")


def test_what_others_say_is_passed_over() -> None:
    drives, _ = rig(2)

    class Busy(DriveBus):
        def receive(self, frames) -> int:
            count = super().receive(frames)
            if count:
                frames[1 : count + 1] = frames[:count].copy()
                frames[0] = np.frombuffer(pack(0, bytes([99, 0, 0, 0, 0, 0])), dtype=np.uint8)
                count += 1
            return count

    assert client([Busy(drives)], 2).configure().counts.tolist() == [32767] * 2


@pytest.mark.parametrize("radians", [12.6, -12.6])
def test_position_at_the_end_of_the_range(radians: float) -> None:
    drives, buses = rig(1)
    drives.objects[0, slots.POSITION] = round(radians * RADIAN)
    assert refusal(buses, 1) == (
        "joint1 (node 1 on can0): position at the end of its range, ±12.5 rad: is its zero set?"
    )


def test_position_outside_of_the_joints_limits() -> None:
    drives, buses = rig(1, lower=-1.0, upper=2.0)
    drives.objects[0, slots.POSITION] = round(2.5 * RADIAN)
    assert refusal(buses, 1, lower=-1.0, upper=2.0) == (
        "joint1 (node 1 on can0): position 2.500 rad is outside of the joint's limits, "
        "-1.000 to 2.000 rad: is its zero set?"
    )
    drives.objects[0, slots.POSITION] = round(2.0001 * RADIAN)  # at its stop, within a step
    client(buses, 1, lower=-1.0, upper=2.0).configure()


def test_position_that_wraps_may_be_anywhere() -> None:
    endless = {"wraps": True, "lower": -np.inf, "upper": np.inf}
    drives, buses = rig(1, **endless)
    drives.objects[0, slots.POSITION] = round(13.0 * RADIAN)
    # (13 + 12.5) · 65535 / 25 = 66845.7, which is 1309 after 65536.
    assert client(buses, 1, **endless).configure().counts.tolist() == [1309]


def test_reported_error() -> None:
    drives, buses = rig(1, answer_bytes=8)
    drives.fault(0, 5)
    assert refusal(buses, 1) == "joint1 (node 1 on can0): reports error 5"


def test_answers_left_by_a_loop_before_are_not_taken_for_new() -> None:
    drives, buses = rig(1)
    buses[0].exchange((1, LEAVE))
    buses[0]._waiting.append(pack(0, bytes([1, 0, 0, 0, 0, 0])))
    drives.objects[0, slots.POSITION] = round(1.0 * RADIAN)
    assert client(buses, 1).configure().counts.tolist() == [35388]


def test_bus_that_takes_nothing() -> None:
    class Full(DriveBus):
        def send(self, frames, count: int) -> int:
            return 0

    drives, _ = rig(1)
    with pytest.raises(BusError, match="can0: takes no frames"):
        client([Full(drives)], 1).configure()


def test_shutdown_takes_torque_off_and_names_the_silent() -> None:
    drives, buses = rig()
    master = client(buses, timeout_s=0.02)
    master.configure()
    drives.objects[:, slots.ENABLED] = 1
    assert master.shutdown() == ()
    assert not drives.operation_enabled.any()
    buses[1].deaf = True
    assert master.shutdown() == ("joint4",)


def test_two_drives_on_one_node_id() -> None:
    _, buses = rig(2)
    twice = DriveConfig(1, 0, scales(1)[0])
    with pytest.raises(InputError, match="node id 1 is taken on can0"):
        MitClient(buses, [twice, twice], 1000.0)


def test_set_up_takes_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "monotonic", lambda: 0.0)
    _, buses = rig()
    client(buses).configure()
