"""The composition: commands against the equations, alignment, gating, and what is not finite."""

import math
from typing import Any

import numpy as np
import pytest

from dftc_rt.control.dftc import Dftc
from dftc_rt.control.interface import NONFINITE_INPUT, NONFINITE_LAW
from dftc_rt.control.laws import build
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    AD,
    AGE,
    NAMES,
    NOT_OBSERVABLE,
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
    S,
    V,
)
from dftc_rt.errors import InputError

H = 1e-3


def _law(n: int = 2, name: str = "dftc", delay: int = 1, ftc: bool = True, **gains: Any) -> Dftc:
    law = build(
        name, n, H, np.full(n, 50.0), np.full(n, 0.01), delay, gains, ftc,
        np.full(n, -3.0), np.full(n, 3.0), np.full(n, 2.0),
    )  # fmt: skip
    assert isinstance(law, Dftc)
    law.start(np.zeros(n), np.zeros(n))
    return law


def _rec(n: int = 2, **rows: float) -> np.ndarray:
    rec = np.zeros((len(NAMES), n))
    for name, value in rows.items():
        rec[NAMES.index(name)] = value
    return rec


def test_first_command_is_equation_10_on_the_split() -> None:
    law = _law(lam=5.0, k=10.0)
    rec = _rec(q=0.1, v=-0.2, qd=0.05, vd=0.3, ad=1.5)
    m, b = np.array([2.0, 3.0]), np.array([4.0, -1.0])
    assert law.update(rec, m, b) == 0
    e, de = 0.1 - 0.05, -0.2 - 0.3
    s = 5.0 * e + de
    u = m * (1.5 - 5.0 * de - 10.0 * s) + b
    np.testing.assert_allclose(rec[S], s)
    np.testing.assert_allclose(rec[TAU_LAW], u, rtol=1e-12)
    np.testing.assert_allclose(rec[TAU_CMD], u, atol=0.0051)
    np.testing.assert_allclose(np.round(rec[TAU_CMD] / 0.01) * 0.01, rec[TAU_CMD], rtol=1e-12)


def test_first_command_of_paper_is_equation_10_on_networks() -> None:
    law = _law(name="paper")
    assert not law.uses_local_terms
    x = np.array([0.9, 0.8])
    rec = _rec(q=x[0], v=x[1], qd=0.5, vd=0.6, ad=-0.4)
    assert law.update(rec, np.full(2, np.nan), np.full(2, np.nan)) == 0
    centres = np.arange(-3.0, 4.0)[:, None] * np.ones(2)
    sigma = np.exp(-((x - centres) ** 2).sum(1) / (2 * 0.5**2))
    weights = np.arange(2.0, 15.0, 2.0)
    f = g = weights @ sigma
    de = x[1] - 0.6
    s = 5.0 * (x[0] - 0.5) + de
    u = -(10.0 * s + f + 0.4 + 5.0 * de) / g
    np.testing.assert_allclose(rec[TAU_LAW], u, rtol=1e-12)
    big_s = 1 + abs(s) + s * s
    state = law.storage.state
    np.testing.assert_allclose(state["delta"], H * 500.0 * abs(s) * big_s, rtol=1e-12)
    np.testing.assert_allclose(state["xi"], H * 400.0 * abs(s), rtol=1e-12)
    for row, drive in ((0, 0.002 * s), (1, 0.002 * s * u)):
        expected = weights + H * drive * sigma
        np.testing.assert_allclose(law.storage.weights[:, row], [expected] * 2, rtol=1e-12)


def test_robust_terms_push_against_s() -> None:
    plain = _law(gamma_delta=0.0, gamma_xi=0.0)
    robust = _law(gamma_delta=50.0, gamma_xi=50.0)
    m, b = np.ones(2), np.zeros(2)
    for _ in range(20):
        one, other = _rec(q=0.02, v=0.2), _rec(q=0.02, v=0.2)
        plain.update(one, m, b)
        robust.update(other, m, b)
    assert (one[S] > 0).all()
    assert (other[TAU_LAW] < one[TAU_LAW] - 0.1).all()


def test_command_is_saturated() -> None:
    law = _law()
    rec = _rec(q=-9.0)
    law.update(rec, np.ones(2), np.zeros(2))
    assert (rec[TAU_LAW] > 50.0).all()
    np.testing.assert_allclose(rec[TAU_CMD], 50.0)


def _drive(
    law: Dftc, cycles: int, rho: float, delay: int, stale: int = 0, noise_std: float = 2e-3
) -> np.ndarray:
    """A single-inertia plant per joint under gravity torque; returns the records."""
    n, m, lag = 2, 2.0, 1e-3
    noise = np.random.default_rng(5).normal(0.0, noise_std, (cycles, n))
    q, v, applied = np.zeros(n), np.full(n, 0.8), np.full(n, 20.0)
    law.start(q, v)
    pipeline = [np.full(n, 20.0)] * delay
    records = np.zeros((cycles, len(NAMES), n))
    for k, rec in enumerate(records):
        t = k * H
        rec[QD], rec[VD], rec[AD] = 0.2 * np.sin(4 * t), 0.8 * np.cos(4 * t), -3.2 * np.sin(4 * t)
        rec[Q], rec[V] = q, v + noise[k]
        if stale and k % stale and k:
            rec[: V + 1] = records[k - 1, : V + 1]
            rec[AGE] = records[k - 1, AGE] + 1
        law.update(rec, np.full(n, m), np.full(n, 20.0))
        pipeline.append(rec[TAU_CMD].copy())
        u = pipeline.pop(0)
        for _ in range(10):
            applied = u + (applied - u) * math.exp(-H / 10 / lag)
            effectiveness = rho if t > 0.5 else 1.0
            v = v + H / 10 * (effectiveness * applied - 20.0) / m
            q = q + H / 10 * v
    return records


@pytest.mark.parametrize("delay", [1, 2, 3])
def test_estimator_is_aligned_to_the_stated_delay(delay: int) -> None:
    gains = {"lam": 8.0, "k": 8.0}
    residual = {}
    for assumed in (delay - 1, delay, delay + 1):
        records = _drive(_law(delay=assumed, **gains), 3000, 1.0, delay, noise_std=0.0)
        residual[assumed] = records[1000:, RESIDUAL].std()
    assert residual[delay] < 0.2 * residual[delay - 1]
    assert residual[delay] < 0.2 * residual[delay + 1]


@pytest.mark.parametrize("observer", ["kalman", "gradient"])
def test_loss_is_estimated_decided_and_compensated(observer: str) -> None:
    records = _drive(_law(observer=observer), 3000, 0.6, 1)
    healthy, late = records[300:500], records[1500:]
    assert not (healthy[:, VERDICT] == ACTUATOR_LOSS).any()
    assert (late[:, VERDICT] == ACTUATOR_LOSS).all()
    assert np.sqrt(((late[:, RHO_HAT] - 0.6) ** 2).mean()) < 0.01
    ratio = late[:, TAU_CMD] / late[:, TAU_LAW]
    assert np.abs(ratio - 1 / 0.6).max() < 0.05
    gated = records[: np.flatnonzero((records[:, VERDICT] == ACTUATOR_LOSS).any(1))[0]]
    told = np.clip(gated[:, TAU_LAW], -50.0, 50.0)
    np.testing.assert_allclose(gated[:, TAU_CMD], told, atol=0.0051)


def test_without_ftc_the_gain_stays_one_and_the_estimate_is_still_there() -> None:
    records = _drive(_law(ftc=False), 2000, 0.6, 1)
    inside = np.abs(records[:, TAU_LAW]) < 50.0
    assert np.abs((records[:, TAU_CMD] - records[:, TAU_LAW])[inside]).max() < 0.0051
    assert np.abs(records[1500:, RHO_HAT] - 0.6).max() < 0.03
    assert (records[1500:, VERDICT] == ACTUATOR_LOSS).all()


def test_recovery_takes_the_verdict_and_the_gain_back() -> None:
    law = _law()
    records = _drive(law, 1500, 0.6, 1)
    assert (records[-1, VERDICT] == ACTUATOR_LOSS).all()
    for _ in range(1500):  # the drive is whole again: y = phi on average
        rec = _rec(q=0.0)
        law.update(rec, np.full(2, 2.0), law.storage.state["applied"].copy())
    assert not (rec[VERDICT] == ACTUATOR_LOSS).any()
    np.testing.assert_array_equal(law.storage.state["gain"], 1.0)


def test_missed_answers_do_not_look_like_a_fault() -> None:
    records = _drive(_law(lam=8.0, k=8.0), 3000, 1.0, 1, stale=4)[500:]
    assert np.abs(records[:, RHO_HAT] - 1.0).max() < 0.05
    assert not (records[:, VERDICT] == ACTUATOR_LOSS).any()
    assert (records[records[:, AGE, 0] > 0][:, OBSERVABLE] == 0).all()


def test_rho_is_held_where_torque_is_below_the_floor() -> None:
    law = _law(warmup_s=0.0)
    for k in range(500):
        rec = _rec(v=0.01 * math.sin(k))
        law.update(rec, np.ones(2), np.zeros(2))
        assert (rec[OBSERVABLE] == 0.0).all()
        assert (rec[VERDICT] == NOT_OBSERVABLE).all()
        assert (rec[RHO_HAT] == 1.0).all()
    assert (rec[RHO_STD] > 0.0).all()


@pytest.mark.parametrize("row", [Q, V, QD, VD, AD])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_bad_input_never_reaches_the_wire_and_leaves_other_joints_alone(
    row: int, value: float
) -> None:
    good, bad = _law(), _law()
    m, b = np.full(2, 2.0), np.full(2, 20.0)
    for k in range(50):
        one, other = _rec(q=0.01), _rec(q=0.01)
        assert good.update(one, m, b) == 0
        if k == 20:
            other[row, 0] = value
        assert bad.update(other, m, b) == (NONFINITE_INPUT if k == 20 else 0)
        assert np.isfinite(other[TAU_CMD]).all()
        assert one[:, 1].tobytes() == other[:, 1].tobytes()
        if k == 20:
            assert other[TAU_CMD, 0] == 0.0
    assert np.isfinite(other[RHO_HAT]).all()


@pytest.mark.parametrize(("m", "b"), [(0.0, 1.0), (math.nan, 1.0), (1.0, math.inf)])
def test_bad_terms_are_bad_input(m: float, b: float) -> None:
    law, rec = _law(), _rec()
    assert law.update(rec, np.full(2, m), np.full(2, b)) == NONFINITE_INPUT
    assert (rec[TAU_CMD] == 0.0).all()


def test_a_singular_printed_law_commands_zero_and_says_so() -> None:
    law = _law(name="paper", w_g=0.0)
    rec = _rec(q=1.0)
    assert law.update(rec, np.ones(2), np.zeros(2)) == NONFINITE_LAW
    assert (rec[TAU_CMD] == 0.0).all()


def test_start_resets_everything() -> None:
    law = _law(gamma_f=5.0)
    m, b = np.full(2, 2.0), np.full(2, 20.0)

    def outputs() -> bytes:
        law.start(np.zeros(2), np.zeros(2))
        out = []
        for k in range(300):
            rec = _rec(q=0.01 * math.sin(0.1 * k), v=0.1)
            law.update(rec, m, b)
            out.append(rec)
        return np.array(out).tobytes()

    assert outputs() == outputs()


def test_start_and_build_refuse_what_is_wrong() -> None:
    law = _law()
    with pytest.raises(InputError):
        law.start(np.zeros(3), np.zeros(3))
    with pytest.raises(InputError):
        law.start(np.full(2, np.nan), np.zeros(2))
    with pytest.raises(InputError, match=r"dftc \| paper"):
        _law(name="magic")
    with pytest.raises(InputError):
        _law(delay=-1)
    with pytest.raises(InputError, match=r"control\.gains\.w_f"):
        _law(w_f=[1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="torque_limit"):
        build("dftc", 1, H, np.array([np.inf]), np.zeros(1), 1, {}, True,
              np.zeros(1), np.ones(1), np.ones(1))  # fmt: skip
