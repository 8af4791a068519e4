"""Numbers that tables are made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2


@dataclass(frozen=True)
class Delays:
    """Distribution of delays of which some never ended.

    Attributes:
        n: How many there are.
        never: How many never ended; they are the longest.
        median: s; infinite if half of them or more never ended.
        most: 95th percentile, s.
        largest: Of those that ended, s; NaN if none did.
    """

    n: int
    never: int
    median: float
    most: float
    largest: float


def delays(values: Sequence[float | None]) -> Delays:
    """Distribution of delays; None stands for never.

    Percentiles are the smallest value that at least that share does not exceed, so that none
    lies between a number and never.
    """
    finite = sorted(value for value in values if value is not None)
    n = len(values)

    def at(share: float) -> float:
        if not n:
            return math.nan
        k = max(math.ceil(share * n - 1e-9), 1) - 1
        return finite[k] if k < len(finite) else math.inf

    return Delays(n, n - len(finite), at(0.5), at(0.95), finite[-1] if finite else math.nan)


def known(values: Sequence[float | None]) -> list[float]:
    """The values that are there."""
    return [value for value in values if value is not None]


def pooled(values: Sequence[float | None]) -> float:
    """Root of the mean square; NaN if there are none."""
    found = known(values)
    return math.sqrt(sum(x * x for x in found) / len(found)) if found else math.nan


def median(values: Sequence[float | None]) -> float:
    """Median of the values that are there; NaN if there are none."""
    found = known(values)
    return float(np.median(found)) if found else math.nan


def quantile(values: Sequence[float | None], share: float) -> float:
    """Quantile of the values that are there, linear between them; NaN if there are none."""
    found = known(values)
    return float(np.quantile(found, share)) if found else math.nan


def largest(values: Sequence[float | None]) -> float:
    """Largest value; NaN if there are none."""
    return max(known(values), default=math.nan)


def poisson_interval(count: int, exposure: float) -> tuple[float, float]:
    """Rate per unit of exposure that a count may stand for: 95 %, both sides, exact.

    Source: F. Garwood, Fiducial limits for the Poisson distribution, Biometrika 28 (1936).
    """
    if exposure <= 0.0:
        return 0.0, math.inf
    low = 0.5 * float(chi2.ppf(0.025, 2 * count)) if count else 0.0
    return low / exposure, 0.5 * float(chi2.ppf(0.975, 2 * count + 2)) / exposure
