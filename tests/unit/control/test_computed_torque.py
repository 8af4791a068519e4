"""B0 against its formula."""

import math

import numpy as np
import pytest

from dftc_rt.control.interface import NONFINITE_INPUT
from dftc_rt.control.laws import build
from dftc_rt.control.signals import NAMES, RHO_HAT, TAU_CMD, TAU_LAW, VERDICT, S
from dftc_rt.errors import InputError
from tests.unit.control.loop import load, make


def test_command_is_inverse_dynamics_of_the_feedback() -> None:
    robot = load("ur5")
    law = make(robot, "computed_torque", ftc=False, lam=5.0, k=10.0)
    rng = np.random.default_rng(4)
    rec = np.zeros((len(NAMES), 6))
    rec[:5] = rng.normal(0.0, 0.1, (5, 6))
    rec[0] += robot.home
    rec[2] += robot.home
    zeros = np.zeros(6)
    law.start(rec[0], rec[1])
    assert law.update(rec, zeros, zeros) == 0
    q, v, qd, vd, ad = rec[:5]
    wanted = ad - 15.0 * (v - vd) - 50.0 * (q - qd)
    np.testing.assert_allclose(rec[TAU_LAW], robot.inverse_dynamics(q, v, wanted), rtol=1e-10)
    np.testing.assert_allclose(rec[S], 5.0 * (q - qd) + v - vd)
    np.testing.assert_allclose(rec[TAU_CMD], rec[TAU_LAW], atol=robot.resolution.max())
    assert np.isnan(rec[RHO_HAT]).all()
    assert (rec[VERDICT] == 4.0).all()


def test_saturates_and_never_sends_what_is_not_finite() -> None:
    robot = load("ur5")
    law = make(robot, "computed_torque")
    rec = np.zeros((len(NAMES), 6))
    rec[2] = 50.0
    law.update(rec, rec[0], rec[0])
    assert (np.abs(rec[TAU_CMD]) <= robot.limit).all()
    assert np.abs(rec[TAU_CMD]).max() > 0.99 * robot.limit.max()
    rec[0, 3] = math.nan
    assert law.update(rec, rec[1], rec[1]) == NONFINITE_INPUT
    assert (rec[TAU_CMD] == 0.0).all()


def test_needs_a_model() -> None:
    one = np.ones(1)
    with pytest.raises(InputError, match="model"):
        build("computed_torque", 1, 1e-3, one, one, 1, {}, False, -one, one, one)
