"""The exchange in real time: ages, late answers, the read budget."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.bus.error_frames import restart_frame, state_frame
from dftc_rt.bus.frame import ERR_FLAG, Frames, pack
from dftc_rt.drives.cia402.client import Cia402Client
from dftc_rt.drives.cia402.cycle import Cia402Cycle
from dftc_rt.errors import BusError
from dftc_rt.rt.clock import FakeClock
from dftc_rt.rt.drive_link import DriveLink
from tests.unit.drives.drive_bus import DriveBus, configs, drives_of, scales

PERIOD = 1_000_000


class TickingClock(FakeClock):
    """Every look at it takes 50 µs, so that waiting for what never comes ends."""

    def now(self) -> int:
        self.time += 50_000
        return self.time


class SlowBus(DriveBus):
    """A bus whose answers can be held back."""

    held = False

    def receive(self, frames: Frames) -> int:
        return 0 if self.held else super().receive(frames)


@pytest.fixture
def joined() -> tuple[DriveLink, SlowBus]:
    sheets = scales(3)
    bus = SlowBus(drives_of(sheets))
    drives = configs(sheets)
    found = Cia402Client([bus], drives, 1000.0).configure()
    link = DriveLink([bus], Cia402Cycle(drives, 1, 1000.0), TickingClock(), 5e-4, lambda *_: None)
    link.start(found)
    return link, bus


def test_answers_of_this_cycle_have_age_zero(joined: tuple[DriveLink, SlowBus]) -> None:
    link, _ = joined
    for k in range(3):
        link.exchange(k, 0)
        assert not link.age.any()
    assert link.missed == 0


def test_silence_ages_every_joint_and_ends_with_the_read_budget(
    joined: tuple[DriveLink, SlowBus],
) -> None:
    link, bus = joined
    link.exchange(0, 0)
    position = link.q.copy()
    bus.deaf = True
    for k in range(1, 4):
        link.exchange(k, 0)
        assert link.age.tolist() == [k] * 3
    assert link.missed == 9
    assert np.array_equal(link.q, position)


def test_late_answer_is_taken_but_never_new(joined: tuple[DriveLink, SlowBus]) -> None:
    link, bus = joined
    link.exchange(0, 0)
    bus.held = True
    for k in (1, 2):
        link.exchange(k, 0)
    assert link.age.tolist() == [2.0] * 3
    bus.held = False
    bus.deaf = True  # only the late answers come: the newest belongs to the tick before
    link.exchange(3, 0)
    assert link.age.tolist() == [1.0] * 3
    bus.deaf = False
    link.exchange(4, 0)
    assert not link.age.any()


class FailingBus(DriveBus):
    """A bus that goes away, or is full, when told; its interface has a name of its own."""

    interface = "slcan7"
    gone = False
    full = False

    def put(self, raw: bytes) -> None:
        """Let the interface say something."""
        self._waiting.append(raw)

    def send(self, frames: Frames, count: int) -> int:
        if self.gone:
            raise BusError(self.name, "the interface went down")
        return 0 if self.full else super().send(frames, count)

    def receive(self, frames: Frames) -> int:
        if self.gone:
            raise BusError(self.name, "the interface went down")
        return super().receive(frames)


class Pair:
    """Two joints on two buses, in operation."""

    def __init__(self) -> None:
        sheets = scales(2)
        self.events: list[tuple[str, str]] = []
        drives = drives_of(sheets, per_bus=1)
        self.buses = [FailingBus(drives, bus) for bus in (0, 1)]
        wired = configs(sheets, per_bus=1)
        found = Cia402Client(self.buses, wired, 1000.0).configure()
        self.link = DriveLink(
            self.buses,
            Cia402Cycle(wired, 2, 1000.0),
            TickingClock(),
            5e-4,
            lambda source, text: self.events.append((source, text)),
            patience=3,
        )
        self.link.start(found)

    def cycle(self, k: int) -> None:
        self.link.exchange(k, 0)
        self.link.command(np.zeros(2))


def test_a_bus_that_goes_away_is_a_fault_and_the_other_goes_on() -> None:
    pair = Pair()
    pair.cycle(0)
    pair.buses[0].gone = True
    pair.cycle(1)
    pair.cycle(2)
    assert pair.link.fault == "bus lost: can0: the interface went down"
    assert pair.link.age.tolist() == [2.0, 0.0]
    pair.buses[1].gone = True
    with pytest.raises(BusError, match="can0: the interface went down"):
        pair.cycle(3)
    pair.link.abandon()  # whoever can still be reached; nobody can


def test_an_interface_that_is_bus_off_is_a_fault() -> None:
    pair = Pair()
    pair.cycle(0)
    for raw in (state_frame("passive", 128, 3), state_frame("bus-off"), restart_frame()):
        pair.buses[1].put(raw)
    pair.cycle(1)
    assert pair.link.fault.startswith("can1: bus-off, slcan7 took itself off")
    assert "ip link set slcan7 type can restart-ms 100" in pair.link.fault
    assert "\n" not in pair.link.fault
    assert pair.events == [
        ("can1", "error passive (errors as sender 128, as receiver 3)"),
        ("can1", "bus-off (errors as sender 128, as receiver 3)"),
        ("can1", "error active again (errors as sender 128, as receiver 3)"),
        ("can1", "restart"),
    ]
    assert pair.link.age.tolist() == [0.0, 0.0]


def test_error_frames_that_are_no_fault_are_counted() -> None:
    pair = Pair()
    for k in range(12):
        pair.buses[0].put(pack(ERR_FLAG | 0x002, bytes(8)))
        pair.cycle(k)
    assert pair.link.fault == ""
    assert pair.link.errors[0].counts == {"lost arbitration": 12}
    assert pair.events == [
        ("can0", "lost arbitration"), ("can0", "lost arbitration (10 so far)"),
    ]  # fmt: skip


def test_a_full_queue_costs_frames_and_then_the_run() -> None:
    pair = Pair()
    pair.cycle(0)
    pair.buses[0].full = True
    for k in (1, 2, 3):
        pair.cycle(k)
    assert pair.link.fault == ""
    assert pair.link.refused == 6  # SYNC and a command each time
    pair.cycle(4)
    assert pair.link.fault.startswith("can0: no room for frames in 3 cycles in a row; ")
    assert "ip link set slcan7 txqueuelen 1000" in pair.link.fault
    assert [source for source, _ in pair.events] == ["can0"]


def test_a_queue_that_empties_in_time_is_forgiven() -> None:
    pair = Pair()
    for k in range(9):
        pair.buses[0].full = k % 3 != 2
        pair.cycle(k)
    assert pair.link.refused > 0
    assert pair.link.fault == ""


@pytest.mark.parametrize(
    ("asked", "sent", "altered"),
    [
        ([1.0, -2.0, 0.5], [1.0, -2.0, 0.5], 0),
        ([np.nan, 2.0, 1.0], [0.0, 2.0, 1.0], 1),
        ([np.inf, -np.inf, 1.0], [0.0, 0.0, 1.0], 2),  # and not the limit
        ([1e300, -3.5, 3.0], [3.0, -3.0, 3.0], 2),
    ],
)
def test_nothing_but_finite_torques_within_the_limit_reach_the_wire(
    asked: list[float], sent: list[float], altered: int
) -> None:
    sheets = scales(3)
    bus = SlowBus(drives_of(sheets))
    drives = configs(sheets)
    found = Cia402Client([bus], drives, 1000.0).configure()
    cycle = Cia402Cycle(drives, 1, 1000.0)
    link = DriveLink(
        [bus], cycle, TickingClock(), 5e-4, lambda *_: None, torque_limit=np.full(3, 3.0)
    )
    link.start(found)
    link.exchange(0, 0)
    link.command(np.array(asked))
    np.testing.assert_allclose(link.sent, sent, atol=0.03)
    assert link.altered == altered
