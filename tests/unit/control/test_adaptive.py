"""B3 against its equations, written down here step by step, and on the exact model."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dftc_rt.control.baselines.adaptive import Adaptive
from dftc_rt.control.interface import NONFINITE_INPUT
from dftc_rt.control.laws import build
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    HEALTHY,
    NOT_OBSERVABLE,
    OBSERVABLE,
    RHO_HAT,
    TAU_CMD,
    TAU_LAW,
    VERDICT,
    S,
)
from dftc_rt.errors import InputError
from tests.unit.control.baselines import Matrices, friction, make, random_record
from tests.unit.control.loop import H, load, run

GAMMA = 3000.0


def _adaptive(name: str = "ur5", **more: object) -> Adaptive:
    settings = {"gamma_theta": 20000.0} | more
    law = make(load(name), "adaptive", **settings)  # type: ignore[arg-type]
    assert isinstance(law, Adaptive)
    return law


def test_law_and_adaptation_step_by_step() -> None:
    robot = load("ur5")
    matrices = Matrices(robot)
    law = _adaptive(
        matrices=matrices, add_friction=friction, resolution=0.0, delay_phase=math.inf,
        lam=3.0, k=7.0, gamma_theta=GAMMA, dead_zone_theta=0.0, warmup_s=0.0,
    )  # fmt: skip
    law.start(robot.home, np.zeros(6))
    gamma = GAMMA * np.diag(matrices.mass_matrix(robot.home)) / robot.limit**2
    theta = np.ones(6)
    moved = False
    for k in range(60):
        rec = random_record(robot, k % 7)
        q, v, qd, vd, ad = rec[:5].copy()
        assert law.update(rec, np.zeros(6), np.zeros(6)) == 0
        mass = matrices.mass_matrix(q)
        vr, ar = vd - 3.0 * (q - qd), ad - 3.0 * (v - vd)
        s = v - vr
        u0 = mass @ ar + matrices.coriolis_matrix(q, v) @ vr + matrices.gravity(q)
        u0 += 2.0 * vd + 0.5 * np.tanh(vd / 0.01) - 7.0 * np.diag(mass) * s
        np.testing.assert_allclose(rec[TAU_LAW], u0, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(rec[S], s, rtol=1e-9)
        wanted = theta * u0
        np.testing.assert_allclose(
            rec[TAU_CMD], np.clip(wanted, -robot.limit, robot.limit), rtol=1e-9
        )
        free = np.abs(wanted) <= robot.limit
        theta = np.where(free, np.clip(theta - H * gamma * s * u0, 1.0, 1.0 / 0.15), theta)
        np.testing.assert_allclose(law.theta, theta, rtol=1e-9)
        np.testing.assert_allclose(rec[RHO_HAT], 1.0 / theta, rtol=1e-9)
        moved = moved or bool((theta > 1.01).any())
    assert moved


def test_estimate_converges_on_the_exact_model() -> None:
    records, _ = run(load("ur5"), _adaptive(), 5.0, rho={2: lambda t: 1.0 if t < 2.0 else 0.6})
    assert np.abs(records[2600:, RHO_HAT, 2] - 0.6).max() < 0.03
    assert (records[2500:, VERDICT, 2] == ACTUATOR_LOSS).all()
    assert (records[1000:2000, RHO_HAT, 2] > 0.97).all()
    loaded = records[1000:, OBSERVABLE] == 1.0
    healthy = np.delete(np.where(loaded, records[1000:, RHO_HAT], 1.0), 2, axis=1)
    assert (healthy > 0.9).all()
    assert not (np.delete(records[:, VERDICT], 2, axis=1) == ACTUATOR_LOSS).any()


def test_estimate_stays_within_its_projection() -> None:
    law = _adaptive(rho_min=0.8)
    records, _ = run(load("ur5"), law, 1.2, rho={1: lambda t: 0.6 if t > 0.4 else 1.0})
    assert records[:, RHO_HAT].max() <= 1.0
    assert records[:, RHO_HAT].min() >= 0.8
    assert records[-1, RHO_HAT, 1] == pytest.approx(0.8)
    assert np.isfinite(records[:, TAU_CMD]).all()
    assert (np.abs(records[:, TAU_CMD]) <= load("ur5").limit).all()


def test_a_loss_is_released_when_it_has_ended() -> None:
    def rho(t: float) -> float:
        return 0.6 if 1.0 < t < 2.0 else 1.0

    records, _ = run(load("ur5"), _adaptive(), 4.0, rho={1: rho})
    verdict = records[:, VERDICT, 1]
    assert (verdict[1500:2000] == ACTUATOR_LOSS).all()
    assert (verdict[3500:] == HEALTHY).all()


def test_frozen_while_saturated_and_before_the_warm_up_ends() -> None:
    robot = load("ur5")
    for far, warmup in ((3.0, 0.0), (0.0, 1.0)):
        law = _adaptive(warmup_s=warmup)
        law.start(robot.home, np.zeros(6))
        rec = random_record(robot, 3)
        rec[2] += far
        for _ in range(20):
            law.update(rec, np.zeros(6), np.zeros(6))
        still = np.abs(rec[TAU_CMD]) >= robot.limit * 0.99 if far else np.ones(6, dtype=bool)
        assert still.any()
        assert (law.theta[still] == 1.0).all()


def test_dead_zone_stops_the_adaptation() -> None:
    robot = load("ur5")
    rec = random_record(robot, 3)
    law = _adaptive(dead_zone_theta=1e3, warmup_s=0.0)
    law.start(robot.home, np.zeros(6))
    law.update(rec, np.zeros(6), np.zeros(6))
    assert (law.theta == 1.0).all()


def test_without_ftc_nothing_adapts_and_nothing_is_claimed() -> None:
    law = _adaptive(ftc=False)
    records, _ = run(load("ur5"), law, 0.5, rho={1: lambda t: 0.6})
    assert (law.theta == 1.0).all()
    assert np.isnan(records[:, RHO_HAT]).all()
    assert (records[:, VERDICT] == NOT_OBSERVABLE).all()


def test_silent_on_bad_input_and_goes_on_after_it() -> None:
    robot = load("ur5")
    law = _adaptive()
    law.start(robot.home, np.zeros(6))
    rec = random_record(robot, 3)
    rec[0, 2] = math.nan
    assert law.update(rec, rec[1], rec[1]) == NONFINITE_INPUT
    assert (rec[TAU_CMD] == 0.0).all()
    rec = random_record(robot, 3)
    assert law.update(rec, rec[1], rec[1]) == 0
    assert (rec[TAU_CMD] != 0.0).all()


def test_needs_matrices() -> None:
    one = np.ones(1)
    with pytest.raises(InputError, match="closed form"):
        build("adaptive", 1, 1e-3, one, one, 1, {}, True, -one, one, one)
