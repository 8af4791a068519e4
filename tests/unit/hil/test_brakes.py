"""Brakes: closed until enabled, closing takes its time where a drive lets go."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.drives.interface import GOAL_STOP
from hil.drive import slots
from hil.drive.brakes import Brakes
from tests.unit.hil.test_rig import PERIOD_S, Bench

CLOSE_S = 0.02


def drives(n: int = 2) -> NDArray[np.int64]:
    return np.zeros((n, slots.N_OBJECTS), dtype=np.int64)


def test_closed_until_enabled() -> None:
    brakes, objects = Brakes(2, CLOSE_S), drives()
    assert not brakes.move(0.0, objects, np.zeros(2, dtype=bool))
    assert brakes.is_open.tolist() == [False, False]
    objects[1, slots.ENABLED] = 1
    assert brakes.move(0.001, objects, np.zeros(2, dtype=bool))
    assert brakes.is_open.tolist() == [False, True]


def test_a_drive_that_holds_is_closed_at_once_and_one_that_lets_go_later() -> None:
    brakes, objects = Brakes(2, CLOSE_S), drives()
    objects[:, slots.ENABLED] = 1
    brakes.move(0.0, objects, np.zeros(2, dtype=bool))
    released = brakes.is_open.copy()
    objects[:, slots.ENABLED] = 0
    objects[1, slots.LETS_GO] = 1
    assert brakes.move(0.100, objects, released)
    assert brakes.is_open.tolist() == [False, True]
    assert brakes.move(0.119, objects, released)
    assert brakes.is_open.tolist() == [False, True]
    brakes.move(0.120, objects, released)
    assert brakes.is_open.tolist() == [False, False]


def test_a_drive_that_comes_back_and_drops_out_again_has_the_whole_time_again() -> None:
    brakes, objects, released = Brakes(1, CLOSE_S), drives(1), np.ones(1, dtype=bool)
    objects[0, slots.LETS_GO] = 1
    for t, enabled, is_open in (
        (0.000, 1, True), (0.010, 0, True), (0.020, 1, True), (0.040, 0, True),
        (0.059, 0, True), (0.060, 0, False), (0.070, 0, False),
    ):  # fmt: skip
        objects[0, slots.ENABLED] = enabled
        brakes.move(t, objects, released)
        assert brakes.is_open.tolist() == [is_open], t


def test_a_drive_in_fault_drops_its_joint_until_the_brake_holds_it() -> None:
    bench = Bench()
    bench.enable(np.zeros(6))
    elbow = 1  # of UR5's joints, one that gravity moves
    bench.rig.drives.fault(elbow, 0x4310)  # type: ignore[attr-defined]
    begun = bench.rig.t
    while bench.rig.plant.released[elbow]:
        assert bench.rig.t < begun + 0.1
        bench.exchange()
        bench.link.command(np.zeros(6))
    assert bench.rig.t == pytest.approx(begun + CLOSE_S + PERIOD_S, abs=1.5 * PERIOD_S)
    v, tau = bench.column(1)[:, elbow], bench.column(2)[:, elbow]
    assert abs(v[-1]) > 0.01  # it fell
    assert tau[-1] == 0.0
    held = bench.rig.plant.q[elbow]
    for _ in range(5):
        bench.exchange()
        bench.link.command(np.zeros(6))
    assert bench.rig.plant.q[elbow] == held
    assert bench.rig.plant.released[[0, 2, 3, 4, 5]].all()  # it dropped out alone


def test_a_quick_stop_holds_every_joint_at_once() -> None:
    bench = Bench()
    bench.enable(np.zeros(6))
    bench.link.goal = GOAL_STOP
    bench.link.command(np.zeros(6))
    bench.exchange()
    assert not bench.rig.plant.released.any()
