"""How soon anybody could have known: the evidence that a run has given of its fault.

With e the torque that is missing, (1 - ρ) times what a healthy drive would have delivered, through
the estimator's filter, and R the variance of one sample of the residual, inflated for its
colour, the evidence for the loss is ½ ∫ e²/R by the time t: the mean log-likelihood ratio of
the loss against no fault. R is that of the calibration's floor; in motion the variance is larger.

A constant torque that began with the fault explains a part of it. What it leaves is the
evidence that the missing torque goes with the torque asked for.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from dftc_rt.calibration.signals import delivered

F64 = NDArray[np.float64]

BANDWIDTH: Final = 80.0
"""Of the filter, rad/s: the estimator's default."""

# A CUSUM tests a loss of 20 %, not the true one, and starts with a drift below 0: three times its
# threshold is what a loss of 20 to 70 % needs to pass it.
ANOMALY_EVIDENCE: Final = 3.0
"""Evidence over ``threshold_anomaly`` at which the information for an anomaly is there."""
ATTRIBUTION_EVIDENCE: Final = 10.0
"""The same for an attribution, which has more to choose from."""
# The explanations are compared by their evidence, and the best has to beat the others by a margin
# of the size of the threshold.
DISTINCT_EVIDENCE: Final = 3.0
"""Evidence against a constant torque, over ``threshold_anomaly``, that makes a loss distinct."""


def delivered_torque(
    command: F64, period_s: float, delay_cycles: NDArray[np.int64], lag_s: F64
) -> F64:
    """φ: torque that healthy drives would deliver, (K, n), Nm.

    Args:
        command: Torque as sent, (K, n), Nm.
        period_s: Control period, s.
        delay_cycles: Cycles from a command to the SYNC that actuates it, (n,).
        lag_s: First-order lag of the drives' torque, (n,), s.
    """
    return delivered(command, period_s, delay_cycles, lag_s)


def filtered(torque: F64, period_s: float) -> F64:
    """A torque (K, …) through the estimator's filter, Nm."""
    share = -np.expm1(-BANDWIDTH * period_s)
    out: F64 = lfilter([share], [1.0, share - 1.0], torque, axis=0)
    return out


def evidence(missing: F64, variance: float, period_s: float) -> F64:
    """Evidence of the samples so far, (K,).

    Args:
        missing: (1 - ρ) φ from the fault on, (K,), Nm.
        variance: R of one sample, inflated, Nm².
        period_s: Control period, s.
    """
    e = filtered(missing, period_s)
    total: F64 = np.cumsum(0.5 * e**2 / variance)
    return total


def distinct_evidence(missing: F64, variance: float, period_s: float) -> F64:
    """The same without what the best constant torque explains, which begins with the fault, (K,).

    Args:
        missing: (1 - ρ) φ from the fault on, (K,), Nm.
        variance: R of one sample, inflated, Nm².
        period_s: Control period, s.
    """
    e = filtered(missing, period_s)
    step = filtered(np.ones_like(missing), period_s)
    left = np.cumsum(e**2) - np.cumsum(e * step) ** 2 / np.cumsum(step**2)
    total: F64 = np.maximum.accumulate(0.5 * np.maximum(left, 0.0) / variance)
    return total


def time_passed(t: F64, values: F64, threshold: float) -> float | None:
    """First time at which growing values reach a threshold; None if they do not.

    Args:
        t: Times, (K,), s.
        values: (K,).
        threshold: What they have to reach.
    """
    k = int(np.searchsorted(values, threshold))
    return float(t[k]) if k < len(t) else None
