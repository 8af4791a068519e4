"""The exchange in real time: ages, late answers, the read budget."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.bus.frame import Frames
from dftc_rt.drives.cia402.client import Cia402Client
from dftc_rt.drives.cia402.cycle import Cia402Cycle
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
