"""The threshold at which B1 gives no more false alarms than ``dftc``.

The law ``momentum`` acts by its ρ̂ all the time, whatever its verdict: its motion does not
depend on its threshold. So a run without any threshold tells the alarms at every one: the
CUSUM of a run with a bound is found again from that of a run without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

FACTORS: Final[tuple[float, ...]] = tuple(float(f"{2.0 ** (0.25 * k):.4g}") for k in range(-12, 61))
"""Factors on the calibrated ``threshold_loss`` that are tried, rising."""
NO_THRESHOLD: Final = 1e12
"""Factor at which nothing is ever decided, and no sum is bounded."""
_TOP: Final = 1.5  # bound of a sum over its largest threshold, as in the law


@dataclass(frozen=True)
class Decision:
    """Settings of the decision of n joints, (n,) each but the period.

    Attributes:
        threshold_loss: As calibrated.
        threshold_anomaly: As calibrated.
        rho_loss: ρ̂ of a loss is below it.
        rho_clear: ρ̂ from which a loss is taken to have ended.
        clear_s: Time that ρ̂ must stay there, s.
        period_s: Control period, s.
    """

    threshold_loss: F64
    threshold_anomaly: F64
    rho_loss: F64
    rho_clear: F64
    clear_s: F64
    period_s: float


def alarms(
    loss: F64,
    rho: F64,
    observable: NDArray[np.bool_],
    decision: Decision,
    factors: Sequence[float] = FACTORS,
) -> NDArray[np.int64]:
    """Entries into verdict actuator loss at every factor, (F,), all joints together.

    A sum that is bounded above is never larger than one that is not, so it is 0 wherever that
    is; elsewhere their steps are the same.

    Args:
        loss: CUSUM of ρ below 1 in a run without a threshold, (K, n).
        rho: ρ̂, (K, n).
        observable: Whether the sum was stepped, (K, n).
        decision: Settings.
        factors: On ``threshold_loss``.
    """
    threshold = np.outer(np.asarray(factors), decision.threshold_loss)
    top = _TOP * np.maximum(threshold, decision.threshold_anomaly)
    steps = np.diff(loss, axis=0, prepend=np.zeros((1, loss.shape[1])))
    zero = loss <= 0.0
    clears = rho >= decision.rho_clear
    may = rho < decision.rho_loss
    total = np.zeros_like(threshold)
    clear_for = np.zeros_like(threshold)
    lost = np.zeros(threshold.shape, np.bool_)
    count = np.zeros(threshold.shape, np.int64)
    for k in range(len(loss)):
        seen = observable[k]
        stepped = np.where(zero[k], 0.0, np.clip(total + steps[k], 0.0, top))
        total = np.where(seen, stepped, total)
        passed = np.where(clears[k], clear_for + decision.period_s, 0.0)
        clear_for = np.where(seen, passed, clear_for)
        over = lost & (clear_for >= decision.clear_s)
        if over.any():
            total[over] = 0.0
            lost &= ~over
        begins = ~lost & may[k] & (total >= threshold)
        if begins.any():
            clear_for[begins] = 0.0
            count += begins
            lost |= begins
    counted: NDArray[np.int64] = count.sum(axis=1)
    return counted


def least_factor(
    counts: Sequence[int] | NDArray[np.int64], at_most: int, factors: Sequence[float] = FACTORS
) -> tuple[float, int] | None:
    """Least factor from which on no factor gives more alarms, and its alarms.

    None if even the largest does.

    Args:
        counts: Alarms at each factor, (F,).
        at_most: Alarms that may be.
        factors: Rising, (F,).
    """
    good = np.flatnonzero(np.asarray(counts) > at_most)
    first = int(good[-1]) + 1 if len(good) else 0
    return None if first == len(factors) else (factors[first], int(counts[first]))
