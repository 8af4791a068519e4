"""PD with gravity compensation against its formula."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from dftc_rt.control.interface import NONFINITE_INPUT
from dftc_rt.control.laws import build
from dftc_rt.control.signals import RHO_HAT, TAU_CMD, TAU_LAW, VERDICT
from dftc_rt.errors import InputError
from tests.unit.control.baselines import friction, make, random_record
from tests.unit.control.loop import load


def test_torque_is_gravity_and_a_constant_pd() -> None:
    robot = load("ur5")
    lam, k = np.linspace(4.0, 6.0, 6), np.linspace(9.0, 12.0, 6)
    law = make(robot, "pd_gravity", add_friction=friction, lam=lam, k=k)
    rec = random_record(robot, 4)
    zeros = np.zeros(6)
    law.start(robot.home, zeros)
    assert law.update(rec, zeros, zeros) == 0
    q, v, qd, vd = rec[:4]
    inertia = np.diag(pin.crba(robot.model, robot.data, robot.home))
    gravity = pin.computeGeneralizedGravity(robot.model, robot.data, q)
    expected = gravity + inertia * (k * lam * (qd - q) + (k + lam) * (vd - v))
    expected += 2.0 * vd + 0.5 * np.tanh(vd / 0.01)
    np.testing.assert_allclose(rec[TAU_LAW], expected, rtol=1e-9)
    np.testing.assert_allclose(rec[TAU_CMD], expected, atol=robot.resolution.max())
    assert np.isnan(rec[RHO_HAT]).all()
    assert (rec[VERDICT] == 4.0).all()


def test_saturates_in_whole_steps_and_is_silent_on_bad_input() -> None:
    robot = load("ur5")
    law = make(robot, "pd_gravity")
    law.start(robot.home, np.zeros(6))
    rec = random_record(robot, 1)
    rec[2] += 5.0
    law.update(rec, rec[5], rec[5])
    assert (np.abs(rec[TAU_CMD]) <= robot.limit).all()
    assert (np.abs(rec[TAU_CMD]) > 0.99 * robot.limit).any()
    counts = rec[TAU_CMD] / robot.resolution
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    rec[1, 3] = math.nan
    assert law.update(rec, rec[5], rec[5]) == NONFINITE_INPUT
    assert (rec[TAU_CMD] == 0.0).all()


def test_needs_a_model() -> None:
    one = np.ones(1)
    with pytest.raises(InputError, match="model"):
        build("pd_gravity", 1, 1e-3, one, one, 1, {}, False, -one, one, one)
