"""Where the training motion has been: the cells of the grid, and how much of the range."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

LEAST_S: Final = 0.05
"""A cell counts as visited from this much time in it on: a few times the filter's memory."""


def time_in_cells(
    q: F64,
    v: F64,
    q_range: tuple[float, float],
    v_range: float,
    grid: tuple[int, int],
    period_s: float,
) -> F64:
    """Time for which each point of the grid was the nearest, (m,), s.

    Args:
        q: Positions, (K,), rad.
        v: Velocities, (K,), rad/s.
        q_range: Ends of the grid, rad.
        v_range: Its highest velocity, rad/s.
        grid: Points along position and velocity.
        period_s: Time that a sample stands for, s.
    """
    row = _nearest(q, *q_range, grid[0])
    column = _nearest(v, -v_range, v_range, grid[1])
    inside = (row >= 0) & (column >= 0)
    cells = row[inside] * grid[1] + column[inside]
    times: F64 = np.bincount(cells, minlength=grid[0] * grid[1]) * np.float64(period_s)
    return times


def _nearest(x: F64, low: float, high: float, count: int) -> NDArray[np.int64]:
    """Index of the nearest of ``count`` even points; -1 beyond half a spacing outside."""
    if count == 1:
        return np.where((x >= low) & (x <= high), 0, -1)
    index = np.rint((x - low) / (high - low) * (count - 1)).astype(np.int64)
    return np.where((index >= 0) & (index < count), index, -1)


def visited(times: Sequence[F64]) -> NDArray[np.bool_]:
    """Cells with at least :data:`LEAST_S` in all runs together, (m,).

    Args:
        times: Of :func:`time_in_cells`, one a run.
    """
    out: NDArray[np.bool_] = np.sum(times, axis=0) >= LEAST_S
    return out
