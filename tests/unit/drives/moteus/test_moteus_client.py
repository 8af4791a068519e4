"""Set-up of moteus drives: who answers, where it is, and one line for what is wrong."""

from __future__ import annotations

import time

import numpy as np
import pytest

from dftc_rt.bus.frame import EFF_FLAG, pack_fd
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.moteus.client import MoteusClient
from dftc_rt.errors import BusError, DriveError, InputError
from hil.drive import slots
from tests.unit.drives.drive_bus import DriveBus
from tests.unit.drives.moteus.moteus_bus import bus_of, configs, drives_of, scales, to

STOP = bytes.fromhex("01000011001d011602110f50")
RADIAN = (1 << 20) / (2 * np.pi)  # encoder counts


def rig(n: int = 5, wakes: bool = False, **sheet: object):
    drives = drives_of(scales(n, **sheet))
    return drives, [bus_of(drives, bus, wakes) for bus in range((n - 1) // 4 + 1)]


def client(
    buses: list[DriveBus], n: int = 5, timeout_s: float = 1.0, **sheet: object
) -> MoteusClient:
    return MoteusClient(buses, configs(scales(n, **sheet)), 1000.0, timeout_s)


def refusal(buses: list[DriveBus], n: int = 5, **sheet: object) -> str:
    with pytest.raises(DriveError) as error:
        client(buses, n, timeout_s=0.02, **sheet).configure()
    return str(error.value)


@pytest.mark.parametrize("wakes", [False, True])
@pytest.mark.parametrize("host_id", [0, 0x21])
def test_configure_finds_every_drive_and_stops_it(wakes: bool, host_id: int) -> None:
    drives, buses = rig(wakes=wakes)
    for bus, nodes in ((buses[0], (1, 2, 3, 4)), (buses[1], (5,))):
        bus.exchange(*(to(node, "01000a") for node in nodes))  # left so by a controller before
        bus.sent.clear()
    assert drives.operation_enabled.all()
    drives.objects[:, slots.POSITION] = np.array([1.0, -2.0, 3.0, -4.0, 0.0]) * RADIAN
    found = client(buses, host_id=host_id).configure()
    assert not drives.operation_enabled.any()
    assert [states.state_of(word) for word in found.statusword] == [states.SWITCHED_ON] * 5
    radians = found.counts / 2**24 * 2 * np.pi  # encoder: 6e-6 rad; float: 2.4e-7 rad up to 0.5 rev
    assert radians == pytest.approx([1.0, -2.0, 3.0, -4.0, 0.0], abs=7e-6)
    head = EFF_FLAG | 0x8000 | host_id << 8
    assert buses[0].sent == [(head | node, STOP) for node in (1, 1, 2, 2, 3, 3, 4, 4)]
    assert buses[1].sent == [(head | 5, STOP)] * 2
    assert not any(bus.take() for bus in buses)  # nothing is left for the loop
    for bus in buses:
        bus.close()


@pytest.mark.parametrize("wakes", [False, True])
def test_missing_drive(wakes: bool) -> None:
    _, buses = rig(wakes=wakes)
    buses[1].deaf = True
    assert refusal(buses) == "joint5 (node 5 on can1): no answer to 'stop' within 0.02 s"
    for bus in buses:
        bus.close()


class Changed(DriveBus):
    """Drives whose answers are changed on their way."""

    def __init__(self, byte: int, value: int) -> None:
        drives, _ = rig(1)
        super().__init__(drives, size=72)
        self._change = byte, value

    def receive(self, frames) -> int:
        count = super().receive(frames)
        byte, value = self._change
        frames[:count, byte] = value
        return count


@pytest.mark.parametrize(
    ("byte", "value", "heard"),
    [
        (1, 7, "identifier 0x700"),  # another drive's
        (0, 9, "identifier 0x109"),  # to another host
        (11, 0x31, "an answer without position and velocity"),
        (9, 0x01, "an answer without mode"),
    ],
)
def test_an_answer_that_is_none(byte: int, value: int, heard: str) -> None:
    line = f"joint1 (node 1 on can0): no answer to 'stop' within 0.02 s; heard {heard}"
    assert refusal([Changed(byte, value)], 1) == line


def test_drive_that_does_not_stop() -> None:
    assert refusal([Changed(10, 12)], 1) == "joint1 (node 1 on can0): does not stop: mode 12"


def test_fault_that_stays_and_one_that_is_cleared() -> None:
    drives, buses = rig(1)
    drives.fault(0, 35)
    assert refusal(buses, 1) == "joint1 (node 1 on can0): in fault, code 35"
    drives.fault(0, 0)
    client(buses, 1).configure()


def test_a_drive_may_answer_before_it_has_stopped() -> None:
    class Slow(DriveBus):
        answered = 0

        def receive(self, frames) -> int:
            count = super().receive(frames)
            if count:
                self.answered += 1
                if self.answered == 1:
                    frames[:count, 10] = 10
            return count

    drives, _ = rig(1)
    client([Slow(drives, size=72)], 1).configure()


def test_what_others_say_is_passed_over() -> None:
    class Busy(DriveBus):
        def receive(self, frames) -> int:
            count = super().receive(frames)
            if count:
                frames[1 : count + 1] = frames[:count].copy()
                frames[0] = np.frombuffer(pack_fd(0x6300, bytes(8)), dtype=np.uint8)
                count += 1
            return count

    drives, _ = rig(2)
    assert client([Busy(drives, size=72)], 2).configure().counts.tolist() == [0, 0]


def test_position_outside_of_the_joints_limits() -> None:
    sheet = {"lower": -1.0, "upper": 2.0, "sign": -1, "zero_offset_rad": 0.25}
    drives, buses = rig(1, **sheet)
    drives.objects[0, slots.POSITION] = round(-(2.5 + 0.25) * RADIAN)
    assert refusal(buses, 1, **sheet) == (
        "joint1 (node 1 on can0): position 2.500 rad is outside of the joint's limits, "
        "-1.000 to 2.000 rad: is its zero set?"
    )
    drives.objects[0, slots.POSITION] = round(-(2.0005 + 0.25) * RADIAN)  # at its stop
    client(buses, 1, **sheet).configure()


@pytest.mark.parametrize("position", [1e30, -1e30, float("nan"), float("inf")])
def test_a_position_that_none_can_be(position: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Found by fuzzing: a joint without limits, and a number beyond every count."""
    _, buses = rig(1)
    asked = client(buses, 1)
    stop = asked._stop

    def stopped(i: int) -> None:
        stop(i)
        asked._found[1] = position

    monkeypatch.setattr(asked, "_stop", stopped)
    with pytest.raises(DriveError, match=r"joint1 .* position of \S+ turns, which none can be"):
        asked.configure()


def test_answers_left_by_a_loop_before_are_not_taken_for_new() -> None:
    drives, buses = rig(1)
    buses[0]._waiting.append(pack_fd(0x100, bytes.fromhex("2100002f01" + "00" * 12 + "505050")))
    drives.objects[0, slots.POSITION] = 1 << 18
    assert client(buses, 1).configure().counts.tolist() == [1 << 22]


def test_bus_that_takes_nothing() -> None:
    class Full(DriveBus):
        def send(self, frames, count: int) -> int:
            return 0

    drives, _ = rig(1)
    with pytest.raises(BusError, match="can0: takes no frames"):
        client([Full(drives, size=72)], 1).configure()


def test_shutdown_takes_torque_off_and_names_the_silent() -> None:
    drives, buses = rig()
    master = client(buses, timeout_s=0.02)
    master.configure()
    buses[0].exchange(*(to(node, "01000a") for node in (1, 2, 3, 4)))
    drives.fault(0, 33)
    assert master.shutdown() == ()
    assert not drives.operation_enabled.any()
    buses[1].deaf = True
    assert master.shutdown() == ("joint5",)


def test_shutdown_names_what_does_not_stop() -> None:
    assert client([Changed(10, 12)], 1).shutdown() == ("joint1",)


def test_two_drives_on_one_node_id() -> None:
    _, buses = rig(2)
    twice = DriveConfig(1, 0, scales(1)[0])
    with pytest.raises(InputError, match="node id 1 is taken on can0"):
        MoteusClient(buses, [twice, twice], 1000.0)


def test_set_up_takes_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "monotonic", lambda: 0.0)
    _, buses = rig()
    client(buses).configure()
