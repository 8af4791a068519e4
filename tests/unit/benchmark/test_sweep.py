"""Alarms at many thresholds from one run, against the decision stepped plainly at each."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.benchmark import sweep

F64 = NDArray[np.float64]
H = 1e-3
ANOMALY = 3.0


def plain(
    ratios: F64, rho: F64, seen: NDArray[np.bool_], threshold: float, clear_s: float
) -> tuple[int, F64]:
    """Entries into a loss of one joint, and its sum; as the law has it."""
    top = 1.5 * max(threshold, ANOMALY)
    total, clear, lost, count, sums = 0.0, 0.0, False, 0, []
    for ratio, r, observed in zip(ratios, rho, seen, strict=True):
        if observed:
            total = min(max(total + ratio, 0.0), top)
            clear = clear + H if r >= 0.95 else 0.0
        sums.append(total)
        if lost and clear < clear_s:
            continue
        if lost:
            lost, total = False, 0.0
        if total >= threshold and r < 0.92:
            lost, clear, count = True, 0.0, count + 1
    return count, np.array(sums)


@pytest.mark.parametrize("seed", range(10))
def test_alarms_are_those_of_runs_with_that_threshold(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k, n = 4000, 3
    drift = np.repeat(rng.choice([-0.2, 0.15], (k // 200, n)), 200, axis=0)
    ratios = drift + rng.normal(0.0, 0.3, (k, n))
    # Of its own: so a sum may be over its threshold long before ρ̂ lets it count, or after.
    rho = np.repeat(rng.choice([0.8, 0.93, 1.0], (k // 100, n)), 100, axis=0)
    seen = rng.uniform(size=(k, n)) > 0.1
    loss = np.column_stack(
        [plain(ratios[:, i], rho[:, i], seen[:, i], 1e12, 0.05)[1] for i in range(n)]
    )
    thresholds = np.array([2.0, 5.0, 9.0])
    decision = sweep.Decision(
        thresholds, np.full(n, ANOMALY), np.full(n, 0.92), np.full(n, 0.95), np.full(n, 0.05), H
    )
    factors = (0.5, 1.0, 2.0, 4.0)
    found = sweep.alarms(loss, rho, seen, decision, factors)
    expected = [
        sum(
            plain(ratios[:, i], rho[:, i], seen[:, i], f * thresholds[i], 0.05)[0] for i in range(n)
        )
        for f in factors
    ]
    assert found.tolist() == expected
    assert found[0] > found[-1]


def test_the_least_factor_is_one_from_which_on_there_are_no_more() -> None:
    factors = (1.0, 2.0, 4.0, 8.0, 16.0)
    assert sweep.least_factor([9, 3, 4, 3, 0], 3, factors) == (8.0, 3)
    assert sweep.least_factor([9, 3, 4, 3, 0], 9, factors) == (1.0, 9)
    assert sweep.least_factor([9, 3, 4, 3, 1], 0, factors) is None
    assert list(sweep.FACTORS) == sorted(sweep.FACTORS)
    assert 1.0 in sweep.FACTORS
