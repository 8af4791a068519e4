"""Ticks that the executor skips: the estimator divides by the time that has really passed."""

from __future__ import annotations

import numpy as np

from dftc_rt.control import laws, signals

PERIOD, INERTIA, BIAS = 1e-3, 1.0, 20.0


def worst_residual(skip: dict[int, int], *, told: bool) -> float:
    """Largest residual, Nm, of one joint with an exact model, behind the first 1.5 s."""
    law = laws.build(
        "dftc", 1, PERIOD, np.array([50.0]), np.array([0.0]), 1, {"torque_lag_s": 0.0}, True,
        np.array([-3.0]), np.array([3.0]), np.array([3.0]),
    )  # fmt: skip
    law.start(np.zeros(1), np.zeros(1))
    rec = np.zeros((len(signals.NAMES), 1))
    q = v = in_force = waiting = worst = 0.0
    k = 0
    while k < 4000:
        angle = 2 * np.pi * k * PERIOD
        rec[signals.Q], rec[signals.V] = q, v
        rec[signals.QD] = 0.3 * np.sin(angle)
        rec[signals.VD] = 0.3 * 2 * np.pi * np.cos(angle)
        rec[signals.AD] = -0.3 * (2 * np.pi) ** 2 * np.sin(angle)
        # This tick's SYNC puts the command of the tick before into force.
        in_force, waiting = waiting, 0.0
        law.update(rec, np.array([INERTIA]), np.array([BIAS]))
        waiting = float(rec[signals.TAU_CMD, 0])
        if k > 1500:
            worst = max(worst, abs(float(rec[signals.RESIDUAL, 0])))
        left_out = skip.get(k, 0)
        for _ in range(1 + left_out):  # no SYNC at a skipped tick: the torque stays
            v += PERIOD * (in_force - BIAS) / INERTIA
            q += PERIOD * v
        if left_out and told:
            law.skip(left_out)
        k += 1 + left_out
    return worst


def test_a_skip_that_is_told_leaves_the_residual_alone() -> None:
    undisturbed = worst_residual({}, told=True)
    assert undisturbed < 0.2
    assert worst_residual({2050: 20}, told=True) < undisturbed + 0.2


def test_a_skip_that_is_not_told_does_not() -> None:
    assert worst_residual({2050: 20}, told=False) > 3.0
