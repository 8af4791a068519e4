"""B2 against its equations: continuous observer, poles, steady state, locality."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from dftc_rt.control.baselines import eso
from dftc_rt.control.baselines.eso import Eso
from dftc_rt.control.interface import NONFINITE_INPUT
from dftc_rt.control.laws import build
from dftc_rt.control.signals import (
    AD,
    AGE,
    NAMES,
    QD,
    RESIDUAL,
    RHO_HAT,
    TAU_CMD,
    TAU_LAW,
    VD,
    VERDICT,
    Q,
    S,
    V,
)
from tests.unit.control.baselines import friction, make, make_single, random_record
from tests.unit.control.loop import H, load

INERTIA, BIAS = 1.7, 4.0
LAM = K = 20.0


def _single(**more: object) -> Eso:
    law = make_single("eso", lam=LAM, k=K, **more)  # type: ignore[arg-type]
    assert isinstance(law, Eso)
    return law


def simulate(
    law: Eso,
    seconds: float,
    disturbance: Callable[[float], float],
    *,
    rho: float = 1.0,
    moving: bool = True,
    missing: Callable[[int], bool] = lambda k: False,
) -> tuple[np.ndarray, np.ndarray]:
    """One joint M q̈ = ρ u - bias + disturbance, exact between SYNCs; records, states z."""
    cycles = round(seconds / H)
    records = np.zeros((cycles, len(NAMES), 1))
    z = np.zeros((cycles, 3))
    q = v = told = 0.0
    law.start(np.zeros(1), np.zeros(1))
    for k in range(cycles):
        rec = records[k]
        t = k * H
        if k:
            a = (rho * told - BIAS + disturbance(t - 0.5 * H)) / INERTIA
            q, v = q + H * v + 0.5 * H * H * a, v + H * a
        if missing(k):
            rec[Q], rec[V] = records[k - 1, Q], records[k - 1, V]
            rec[AGE] = records[k - 1, AGE] + 1.0
        else:
            rec[Q], rec[V] = q, v
        if moving:
            w = 2.0 * math.pi * 0.5
            rec[QD], rec[VD] = 0.3 * (1 - np.cos(w * t)), 0.3 * w * np.sin(w * t)
            rec[AD] = 0.3 * w * w * np.cos(w * t)
        assert law.update(rec, np.array([INERTIA]), np.array([BIAS])) == 0
        told = float(rec[TAU_CMD, 0])
        z[k] = [law.state[0][name] for name in ("z1", "z2", "z3")]
    return records, z


@pytest.mark.parametrize("omega", [5.0, 60.0, 300.0])
def test_gains_put_three_poles_at_one_place(omega: float) -> None:
    # The error after correction: (I - L C) Φ, Φ the triple integrator over one period.
    phi = np.array([[1.0, H, 0.5 * H * H], [0.0, 1.0, H], [0.0, 0.0, 1.0]])
    gain = eso.gains(np.array([omega]), H)[:, 0]
    error = (np.eye(3) - np.outer(gain, [1.0, 0.0, 0.0])) @ phi
    pole = math.exp(-omega * H)
    np.testing.assert_allclose(np.poly(error), np.poly([pole] * 3), atol=1e-9)


def test_gains_are_those_of_the_continuous_observer_for_short_periods() -> None:
    omega, period = 50.0, 1e-6
    gain = eso.gains(np.array([omega]), period)[:, 0]
    np.testing.assert_allclose(
        gain, period * np.array([3 * omega, 3 * omega**2, omega**3]), rtol=1e-3
    )


@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_observer_follows_its_differential_equations(ratio: float) -> None:
    def disturbance(t: float) -> float:
        return 3.0 * math.sin(9.0 * t)

    records, z = simulate(_single(eso_ratio=ratio), 1.5, disturbance)
    q, u = records[:, Q, 0], records[:, TAU_CMD, 0]
    omega, fine = ratio * LAM, 50
    x = np.zeros(3)
    expected = np.zeros((len(q), 3))
    for k in range(1, len(q)):
        for j in range(fine):
            between = q[k - 1] + (q[k] - q[k - 1]) * (j + 0.5) / fine
            error = between - x[0]
            rate = np.array([
                x[1] + 3.0 * omega * error,
                x[2] + (u[k - 1] - BIAS) / INERTIA + 3.0 * omega**2 * error,
                omega**3 * error,
            ])  # fmt: skip
            x = x + H / fine * rate
        expected[k] = x
    for i, allowed in enumerate((0.01, 0.03, 0.06)):
        scale = np.abs(expected[:, i]).max()
        assert np.abs(z[:, i] - expected[:, i]).max() < allowed * scale


def test_command_is_that_of_the_formula() -> None:
    for velocity in ("measured", "estimated"):
        law = _single(eso_velocity=velocity)
        records, z = simulate(law, 0.3, lambda t: 2.0)
        q, v, qd, vd, ad = records[:, :5, 0].T
        fed = v if velocity == "measured" else z[:, 1]
        wanted = ad + LAM * K * (qd - q) + (LAM + K) * (vd - fed) - z[:, 2]
        np.testing.assert_allclose(records[:, TAU_LAW, 0], BIAS + INERTIA * wanted, rtol=1e-9)
        np.testing.assert_allclose(records[:, S, 0], LAM * (q - qd) + v - vd, atol=1e-12)
        assert np.isnan(records[:, RHO_HAT]).all()
        assert (records[:, VERDICT] == 4.0).all()


def test_estimate_is_the_lumped_disturbance_in_steady_state() -> None:
    records, z = simulate(_single(), 2.0, lambda t: -2.5, moving=False)
    assert INERTIA * z[-1, 2] == pytest.approx(-2.5, rel=1e-6)
    assert records[-1, RESIDUAL, 0] == pytest.approx(-2.5, rel=1e-6)
    assert abs(records[-1, Q, 0]) < 1e-9


def test_a_loss_is_a_disturbance_that_is_cancelled() -> None:
    records, _ = simulate(_single(), 2.0, lambda t: 0.0, rho=0.6, moving=False)
    told = records[-1, TAU_CMD, 0]
    assert 0.6 * told == pytest.approx(BIAS, rel=1e-6)  # the joint stands still
    assert records[-1, RESIDUAL, 0] == pytest.approx(-0.4 * told, rel=1e-6)
    assert abs(records[-1, Q, 0]) < 1e-9


def test_without_ftc_the_estimate_does_not_act() -> None:
    records, z = simulate(_single(ftc=False), 2.0, lambda t: -2.5, moving=False)
    assert INERTIA * z[-1, 2] == pytest.approx(-2.5, rel=1e-6)
    assert records[-1, Q, 0] == pytest.approx(-2.5 / (INERTIA * LAM * K), rel=1e-6)


def test_without_the_split_gravity_is_a_disturbance_too() -> None:
    records, _ = simulate(_single(eso_model="none"), 2.0, lambda t: 0.0, moving=False)
    assert records[-1, RESIDUAL, 0] == pytest.approx(-BIAS, rel=1e-6)
    assert records[-1, TAU_CMD, 0] == pytest.approx(BIAS, rel=1e-6)


def test_saturation_does_not_wind_it_up() -> None:
    law = _single(limit=12.0)
    law.start(np.zeros(1), np.zeros(1))
    q = v = told = 0.0
    saturated = 0
    for k in range(400):  # a step of the reference that the drive cannot follow
        rec = np.zeros((len(NAMES), 1))
        if k:
            a = (told - BIAS) / INERTIA
            q, v = q + H * v + 0.5 * H * H * a, v + H * a
        rec[Q], rec[V], rec[QD] = q, v, 1.0
        law.update(rec, np.array([INERTIA]), np.array([BIAS]))
        told = float(rec[TAU_CMD, 0])
        saturated += abs(rec[TAU_LAW, 0]) > 12.0
        assert abs(told) <= 12.0
        assert abs(INERTIA * law.state[0]["z3"]) < 0.01
    assert saturated > 50


def test_an_answer_that_is_missing_is_bridged_by_the_model() -> None:
    plain, _ = simulate(_single(), 1.0, lambda t: -2.5)
    gaps, _ = simulate(_single(), 1.0, lambda t: -2.5, missing=lambda k: 500 <= k < 510)
    assert np.abs(gaps[600:, Q] - plain[600:, Q]).max() < 1e-3
    assert np.abs(gaps[500:520, RESIDUAL] - plain[500:520, RESIDUAL]).max() < 0.05


def test_skipped_ticks_are_predicted() -> None:
    law = _single()
    simulate(law, 0.5, lambda t: 0.0, moving=False)
    before = law.state[0].copy()
    law.skip(3)
    after = law.state[0]
    told = law.history[0, (before["cycle"] - 1) % law.history.shape[1]]
    a = before["z3"] + (told - BIAS) / INERTIA
    assert after["z2"] == pytest.approx(before["z2"] + 3 * H * a, abs=1e-12)
    assert after["cycle"] == before["cycle"]


def test_quantised_and_within_the_limit() -> None:
    robot = load("ur5")
    law = make(robot, "eso", add_friction=friction)
    law.start(robot.home, np.zeros(6))
    rec = random_record(robot, 2)
    rec[2, :3] += 5.0
    assert law.update(rec, np.ones(6), np.zeros(6)) == 0
    counts = rec[TAU_CMD] / robot.resolution
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    assert (np.abs(rec[TAU_CMD]) <= robot.limit).all()
    assert (np.abs(rec[TAU_CMD, :3]) > 0.99 * robot.limit[:3]).all()


def test_one_joint_knows_nothing_of_another() -> None:
    robot = load("ur5")
    commands = []
    for push in (0.0, 1e-4):
        law = make(robot, "eso", resolution=0.0, lam=1.0, k=1.0)
        law.start(robot.home, np.zeros(6))
        for k in range(20):
            rec = random_record(robot, k)
            rec[Q, 3] += push
            rec[V, 3] -= push
            law.update(rec, np.ones(6), np.full(6, 3.0))
        commands.append(rec[TAU_CMD].copy())
    same = commands[0] == commands[1]
    assert same.tolist() == [True, True, True, False, True, True]


def test_calibrated_friction_is_known_without_the_split_too() -> None:
    torques = []
    for add in (None, friction):
        robot = load("ur5")
        law = make(robot, "eso", add_friction=add, eso_model="none")
        law.start(robot.home, np.zeros(6))
        rec = random_record(robot, 2)
        law.update(rec, np.ones(6), np.full(6, 3.0))
        torques.append(rec[TAU_LAW].copy())
    vd = rec[VD]
    np.testing.assert_allclose(
        torques[1] - torques[0], 2.0 * vd + 0.5 * np.tanh(vd / 0.01), rtol=1e-9
    )


def test_silent_on_bad_input_and_goes_on_after_it() -> None:
    robot = load("ur5")
    law = make(robot, "eso")
    law.start(robot.home, np.zeros(6))
    ones = np.ones(6)
    for bad in range(3):
        rec, m, b = random_record(robot, 1), ones.copy(), ones.copy()
        (rec[Q], m, b)[bad][2] = (math.nan, 0.0, math.inf)[bad]
        assert law.update(rec, m, b) == NONFINITE_INPUT
        assert (rec[TAU_CMD] == 0.0).all()
    rec = random_record(robot, 1)
    assert law.update(rec, ones, ones) == 0
    assert np.isfinite(rec[TAU_CMD]).all()
    assert (rec[TAU_CMD] != 0.0).all()


def test_needs_no_model_of_the_whole_robot() -> None:
    one = np.ones(1)
    law = build("eso", 1, 1e-3, one, one, 1, {}, True, -one, one, one)
    assert law.uses_local_terms
