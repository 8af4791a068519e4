"""Percentiles of what a cycle took."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def percentiles_us(seconds: NDArray[np.float64]) -> dict[str, float | None]:
    """p50, p99, p999 and max of durations.

    Args:
        seconds: Shape ``(K,)``, s; entries that are not finite are left out.

    Returns:
        µs; None for each when there is nothing to tell.
    """
    names = ("p50", "p99", "p999", "max")
    finite = seconds[np.isfinite(seconds)]
    if not len(finite):
        return dict.fromkeys(names)
    values = np.percentile(finite, [50.0, 99.0, 99.9, 100.0]) * 1e6
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def period_s(t: NDArray[np.float64]) -> float:
    """Period of the loop, s: the median step of the scheduled times; 0 for under two.

    Args:
        t: Scheduled times, shape ``(K,)``, s.
    """
    return float(np.median(np.diff(t))) if len(t) > 1 else 0.0
