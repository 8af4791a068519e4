"""Fewer points that look the same."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray


def extremes(values: NDArray[np.float64], points: int) -> NDArray[np.intp]:
    """Indices of about ``points`` samples that keep every peak.

    The smallest and the largest of each of ``points / 2`` equal stretches, so that no
    spike is lost, as a plain stride would lose it.

    Args:
        values: Shape ``(K,)``; NaN is passed over.
        points: How many to keep, about.

    Returns:
        Ascending indices; all of them when there are few enough.
    """
    count = len(values)
    if count <= points:
        return np.arange(count)
    edges = np.linspace(0, count, points // 2 + 1).astype(np.intp)
    low = np.where(np.isnan(values), np.inf, values)
    high = np.where(np.isnan(values), -np.inf, values)
    kept = [0, count - 1]
    for start, end in pairwise(edges):
        kept.append(start + int(np.argmin(low[start:end])))
        kept.append(start + int(np.argmax(high[start:end])))
    return np.unique(np.array(kept, np.intp))
