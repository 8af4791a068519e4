"""The set-up limit on λ and k against the mass matrix of a real arm and of a hand-made pair."""

import numpy as np
import pinocchio as pin
import pytest

from dftc_rt.control import derate
from dftc_rt.control.dftc import Dftc
from dftc_rt.control.layout import Joints
from tests.unit.control.loop import load, make


def test_mass_matrix_is_crba() -> None:
    robot = load("panda")
    upper = np.triu(pin.crba(robot.model, robot.data, robot.home))
    expected = upper + np.triu(upper, 1).T
    got = derate.mass_matrix(robot.inverse_dynamics, robot.home)
    np.testing.assert_allclose(got, expected, atol=1e-10)


def test_crossover_of_two_joints_on_nearly_one_axis() -> None:
    mass = np.array([[1.0, 0.9], [0.9, 1.0]])
    fastest, share = derate.crossover(mass, np.array([30.0, 30.0]))
    assert fastest == pytest.approx(30.0 / (1.0 - 0.9))
    np.testing.assert_allclose(share, 1.0)


def test_gains_are_lowered_until_the_mode_is_slow_enough() -> None:
    mass = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    joints = Joints(
        1e-3, np.ones(3), np.ones(3), np.ones(3, np.int64), -np.ones(3), np.ones(3), np.ones(3)
    )
    rate = np.full(3, 100.0)
    factor = derate.factors(lambda _q, _v, a: mass @ a, joints, rate, 1e-3, 1.0)
    fastest, _ = derate.crossover(mass, rate * factor)
    assert 0.75 * 400.0 <= fastest <= 400.0
    assert factor[2] == 1.0


def test_panda_is_lowered_ur5_hardly_and_infinity_turns_it_off() -> None:
    panda, ur5, free = (
        make(load("panda")),
        make(load("ur5")),
        make(load("panda"), delay_phase=float("inf")),
    )
    assert isinstance(panda, Dftc)
    assert isinstance(ur5, Dftc)
    assert isinstance(free, Dftc)
    assert panda.storage.parameters["lam"].min() < 12.0
    assert ur5.storage.parameters["lam"].min() > 20.0
    assert (free.storage.parameters["lam"] == 25.0).all()
