"""Decision thresholds for a stated false-alarm rate.

A few minutes of fault-free data cannot show an alarm that may come once in ten hours. The
largest value of a CUSUM in each block of time has an exponential tail (the walk drifts down, so
every further step up costs the same factor); the tail is fitted above a quantile and followed
to the rate that is wanted.

Source: peaks over a threshold with shape 0, S. Coles, An Introduction to Statistical Modeling of
Extreme Values (2001), chapter 4.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

BLOCK_S: Final = 1.0
"""Length of a block, s: longer than the estimator's memory, so that blocks are independent."""
_QUANTILE: Final = 0.7
_LEAST_SCALE: Final = 1.0  # log-likelihood ratios fall off like exp(-x) when all is as assumed
_FEWEST: Final = 5


def block_maxima(values: F64, period_s: float) -> F64:
    """Largest value in each full block of a series (K,)."""
    size = max(round(BLOCK_S / period_s), 1)
    count = len(values) // size
    maxima: F64 = values[: count * size].reshape(count, size).max(axis=1)
    return maxima


def threshold(maxima: F64, alarms_per_hour: float) -> float:
    """Value that a block's largest exceeds at the stated rate.

    Args:
        maxima: Largest value of each block, (B,).
        alarms_per_hour: Wanted rate.
    """
    wanted = alarms_per_hour * BLOCK_S / 3600.0
    start = float(np.quantile(maxima, _QUANTILE)) if maxima.size else 0.0
    above = maxima[maxima > start] - start
    scale = max(float(above.mean()), _LEAST_SCALE) if above.size >= _FEWEST else _LEAST_SCALE
    share = 1.0 - _QUANTILE
    return start + scale * float(np.log(max(share / wanted, 1.0)))
