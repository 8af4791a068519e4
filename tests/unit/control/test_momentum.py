"""B1 against its equations, written down here step by step, and on the exact model."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from dftc_rt.control.baselines.momentum import Momentum
from dftc_rt.control.interface import NONFINITE_INPUT
from dftc_rt.control.laws import build
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    AGE,
    OBSERVABLE,
    QD,
    RESIDUAL,
    RHO_HAT,
    RHO_STD,
    TAU_CMD,
    TAU_LAW,
    VD,
    VERDICT,
    Q,
    V,
)
from dftc_rt.errors import InputError
from tests.unit.control.baselines import Matrices, friction, make, random_record
from tests.unit.control.loop import H, load, run

BANDWIDTH, MEMORY, FINE = 60.0, 0.2, 40


def _momentum(name: str = "ur5", **more: object) -> Momentum:
    law = make(load(name), "momentum", **more)  # type: ignore[arg-type]
    assert isinstance(law, Momentum)
    return law


def _loss(t: float) -> float:
    return 1.0 if t < 1.5 else 0.6


def drives(commands: np.ndarray, lag: float) -> np.ndarray:
    """Torque of healthy drives, mean over the period before each SYNC: delay 1, first-order lag."""
    out = np.zeros_like(commands)
    torque = np.zeros(commands.shape[1])
    for k in range(len(commands)):
        told = commands[k - 2] if k >= 2 else np.zeros_like(torque)
        mean = np.zeros_like(torque)
        for _ in range(400):
            torque = torque + (told - torque) * (H / 400) / lag
            mean += torque / 400
        out[k] = mean
    return out


def test_observer_and_regression_step_by_step() -> None:
    robot = load("ur5")
    matrices = Matrices(robot)
    law = _momentum(
        add_friction=friction, momentum_bandwidth=BANDWIDTH, momentum_memory_s=MEMORY, warmup_s=0.0,
    )  # fmt: skip
    records, _ = run(robot, law, 1.0, rho={1: lambda t: 0.7})
    torque = drives(records[:, TAU_CMD], 1e-3)
    n = robot.n
    p, need = np.zeros((2, len(records), n))
    for k, rec in enumerate(records):
        q, v, vd = rec[Q], rec[V], rec[VD]
        p[k] = matrices.mass_matrix(q) @ v
        need[k] = matrices.gravity(q) - matrices.coriolis_matrix(q, v).T @ v
        need[k] += 2.0 * vd + 0.5 * np.tanh(vd / 0.01)
    r, u_f, square, product = np.zeros((4, n))
    kept = math.exp(-H / MEMORY)
    floor = 0.1 + 0.007 * robot.limit
    seen = 0
    for k in range(1, len(records)):
        # ṙ = K (ṗ - u - Cᵀ q̇ + G + τ̂ - r), all but r constant over the period
        drive = (p[k] - p[k - 1]) / H + 0.5 * (need[k] + need[k - 1]) - torque[k]
        for _ in range(FINE):
            r = r + H / FINE * BANDWIDTH * (drive - r)
            u_f = u_f + H / FINE * BANDWIDTH * (torque[k] - u_f)
        square = kept * square + (1.0 - kept) * u_f**2
        product = kept * product + (1.0 - kept) * r * u_f
        scale = np.abs(u_f) + 1.0
        assert (np.abs(records[k, RESIDUAL] - r) < 0.01 * (np.abs(r) + scale)).all()
        excited = square > 1.02 * (3.0 * floor) ** 2
        if k > 20 and excited.any():
            seen += int(excited.sum())
            expected = np.clip(1.0 + product / np.where(excited, square, 1.0), 0.0, 1.2)
            assert np.abs(records[k, RHO_HAT] - expected)[excited].max() < 0.01
            assert (records[k, OBSERVABLE][excited] == 1.0).all()
    assert seen > 1000


def test_command_is_the_law_over_the_estimate() -> None:
    robot = load("ur5")
    lam, k = np.linspace(4.0, 6.0, 6), np.linspace(9.0, 12.0, 6)
    law = _momentum(
        momentum_gate="always", gain_rate=1e9, resolution=0.0, add_friction=friction, lam=lam, k=k
    )
    records, _ = run(robot, law, 1.0, rho={1: lambda t: 0.7})
    matrices = Matrices(robot)
    for rec in records[::50]:
        q, v, qd, vd, ad = rec[:5]
        mass = matrices.mass_matrix(q)
        u0 = mass @ ad + matrices.coriolis_matrix(q, v) @ v + matrices.gravity(q)
        u0 += np.diag(mass) * ((lam + k) * (vd - v) + lam * k * (qd - q))
        u0 += 2.0 * vd + 0.5 * np.tanh(vd / 0.01)
        np.testing.assert_allclose(rec[TAU_LAW], u0, rtol=1e-6, atol=1e-6)
        wanted = rec[TAU_LAW] / np.clip(rec[RHO_HAT], 0.15, 1.0)
        np.testing.assert_allclose(rec[TAU_CMD], np.clip(wanted, -robot.limit, robot.limit))


def test_estimate_converges_on_the_exact_model_and_is_decided() -> None:
    records, _ = run(load("ur5"), _momentum(), 3.0, rho={2: _loss})
    assert np.abs(records[2000:, RHO_HAT, 2] - 0.6).max() < 0.02
    first = int(np.flatnonzero(records[:, VERDICT, 2] == ACTUATOR_LOSS)[0])
    assert 1500 < first < 1800
    assert (records[first:, VERDICT, 2] == ACTUATOR_LOSS).all()
    assert not (np.delete(records[:, VERDICT], 2, axis=1) == ACTUATOR_LOSS).any()
    healthy = np.delete(records[:, RHO_HAT], 2, axis=1)[300:]
    observable = np.delete(records[:, OBSERVABLE], 2, axis=1)[300:] == 1.0
    assert np.abs(healthy - 1.0)[observable].max() < 0.1
    std = records[2000:, RHO_STD, 2]
    assert ((std > 0.0) & (std < 0.1)).all()
    # the residual is the torque that is missing
    missing = -0.4 * records[2000:, TAU_CMD, 2]
    assert np.abs(records[2000:, RESIDUAL, 2] - missing).mean() < 0.05 * np.abs(missing).mean()


def test_tracking_returns_after_the_loss() -> None:
    robot = load("ur5")
    with_gain, truth = run(robot, _momentum(), 3.0, rho={2: _loss})
    error = np.abs(truth - with_gain[:, QD])[2500:, 2].max()
    without, truth = run(robot, _momentum(ftc=False), 3.0, rho={2: _loss})
    worse = np.abs(truth - without[:, QD])[2500:, 2].max()
    assert error < 0.05 * worse
    assert np.abs(without[2000:, RHO_HAT, 2] - 0.6).max() < 0.02
    np.testing.assert_allclose(
        without[:, TAU_CMD],
        np.clip(without[:, TAU_LAW], -robot.limit, robot.limit),
        atol=robot.resolution.max(),
    )


def test_the_gain_may_wait_for_the_verdict() -> None:
    robot = load("ur5")
    records, _ = run(robot, _momentum(momentum_gate="attributed"), 2.5, rho={2: _loss})
    lost = np.maximum.accumulate(records[:, VERDICT] == ACTUATOR_LOSS, axis=0)
    assert lost[-1].tolist() == [False, False, True, False, False, False]
    free = ~lost & (np.abs(records[:, TAU_LAW]) < robot.limit)
    difference = np.abs(records[:, TAU_CMD] - records[:, TAU_LAW])
    assert (difference <= 0.51 * robot.resolution)[free].all()
    last = records[-1, :, 2]
    assert last[TAU_CMD] == pytest.approx(last[TAU_LAW] / last[RHO_HAT], rel=0.01)


def test_a_loss_is_released_when_it_has_ended() -> None:
    def rho(t: float) -> float:
        return 0.6 if 0.8 < t < 1.5 else 1.0

    records, _ = run(load("ur5"), _momentum(momentum_gate="attributed"), 3.0, rho={1: rho})
    verdict = records[:, VERDICT, 1]
    assert (verdict[1200:1500] == ACTUATOR_LOSS).all()
    assert (verdict[2500:] != ACTUATOR_LOSS).all()
    np.testing.assert_allclose(
        records[2700:, TAU_CMD, 1], records[2700:, TAU_LAW, 1], atol=load("ur5").resolution.max()
    )


def _standing(law: Momentum, change: Callable[[int, np.ndarray], None], cycles: int) -> np.ndarray:
    """Feed a robot that stands at home; ``change`` may spoil the record of a cycle."""
    robot = load("ur5")
    law.start(robot.home, np.zeros(6))
    out = []
    for k in range(cycles):
        rec = random_record(robot, 0)
        rec[:5] = 0.0
        rec[Q] = rec[QD] = robot.home
        change(k, rec)
        law.update(rec, rec[5], rec[5])
        out.append(rec)
    return np.array(out)


def test_an_estimate_is_held_where_there_is_no_torque() -> None:
    records = _standing(_momentum(), lambda k, rec: None, 600)
    held = records[-1, OBSERVABLE] == 0.0
    assert held[0]  # a vertical axis at rest needs none
    assert not held[1]
    assert (records[:, RHO_HAT, held] == 1.0).all()
    assert np.isnan(records[-1, RHO_STD, held]).all()
    assert np.abs(records[-1, RESIDUAL]).max() < 1e-2


def test_missing_answers_and_skipped_ticks_leave_the_residual_alone() -> None:
    def stale(k: int, rec: np.ndarray) -> None:
        if 500 <= k < 520:
            rec[AGE, 4] = k - 499.0

    records = _standing(_momentum(), stale, 600)
    assert np.abs(records[500:, RESIDUAL]).max() < 1e-2
    assert (records[500:520, OBSERVABLE] == 0.0).all()
    law = _momentum()

    def skipped(k: int, rec: np.ndarray) -> None:
        if k == 500:
            law.skip(10)

    assert np.abs(_standing(law, skipped, 600)[500:, RESIDUAL]).max() < 1e-2


def test_silent_on_bad_input_and_the_silence_is_no_fault() -> None:
    def spoil(k: int, rec: np.ndarray) -> None:
        if 500 <= k < 505:
            rec[V, 3] = math.nan

    law = _momentum()
    records = _standing(law, spoil, 500)
    assert law.update(np.full((14, 6), math.nan), np.ones(6), np.ones(6)) == NONFINITE_INPUT
    records = _standing(_momentum(), spoil, 520)
    assert (records[500:505, TAU_CMD] == 0.0).all()
    assert (records[505:, TAU_CMD, 1] != 0.0).all()
    # 0 Nm were sent for 5 ms, and the arm of this test stood still all the same
    held = records[506:, RESIDUAL, 1] / records[499, TAU_CMD, 1]
    assert 0.2 < held.max() < 0.6


def test_a_gap_in_the_answers_of_a_moving_robot_is_divided_by_its_length() -> None:
    robot = load("ur5")
    seen, _ = run(robot, _momentum(), 1.0)
    worst = []
    for gap in (False, True):
        law = _momentum()
        law.start(robot.home, np.zeros(6))
        largest = 0.0
        for k, logged in enumerate(seen):
            rec = logged.copy()
            if gap and 700 <= k < 720:
                rec[:2], rec[AGE] = seen[699, :2], k - 699.0
            law.update(rec, rec[5], rec[5])
            law.history[:, k % law.history.shape[1]] = logged[TAU_CMD]
            if k >= 700:
                largest = max(largest, float(np.abs(rec[RESIDUAL]).max()))
        worst.append(largest)
    assert worst[1] < worst[0] + 0.3
    assert np.abs(seen[700:720, V]).max() > 0.1


def test_needs_model_and_matrices() -> None:
    one = np.ones(1)
    with pytest.raises(InputError, match="model"):
        build("momentum", 1, 1e-3, one, one, 1, {}, True, -one, one, one)
    with pytest.raises(InputError, match="closed form"):
        build(
            "momentum", 1, 1e-3, one, one, 1, {}, True, -one, one, one,
            inverse_dynamics=lambda q, v, a: a,
        )  # fmt: skip
