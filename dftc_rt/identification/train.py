"""Training of all joints: columns, cross-validation, weights in the units of the law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.identification.coverage import time_in_cells, visited
from dftc_rt.identification.regressors import Basis, Samples, columns
from dftc_rt.identification.ridge import Choice, Fold, choose

F64 = NDArray[np.float64]

SPACING_S: Final = 0.01
"""Of the samples that are kept: the observer's filter leaves no more information."""


@dataclass(frozen=True, eq=False)
class Grid:
    """The grid of one joint.

    Attributes:
        basis: Its Gaussians, m of them.
        q_range: Ends along the position, rad.
        v_range: Highest velocity, rad/s.
        points: Along position and velocity.
    """

    basis: Basis
    q_range: tuple[float, float]
    v_range: float
    points: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Trained:
    """What one joint learned.

    Attributes:
        w_fo: Ŵ_fo, (m,), rad/s².
        w_go: Ŵ_go, (m,).
        visited: (m,).
        q_seen: Part of the position range between the extremes of the motion.
        v_seen: Largest speed of the motion over that of the grid.
        choice: How the weights were chosen.
    """

    w_fo: F64
    w_go: F64
    visited: NDArray[np.bool_]
    q_seen: float
    v_seen: float
    choice: Choice


def train(
    runs: Sequence[Samples], grid: Grid, torque_limit: float, period_s: float, skip_s: float
) -> Trained:
    """Weights of one joint from fault-free runs.

    Args:
        runs: Two or more, on different motion.
        grid: The joint's grid.
        torque_limit: Nm; residuals are judged in parts of it.
        period_s: Control period, s.
        skip_s: Left out at the start of each run: blend-in and the filters' beginning, s.
    """
    start = round(skip_s / period_s)
    every = max(round(SPACING_S / period_s), 1)
    m = grid.basis.centres.shape[0]
    where = [
        time_in_cells(
            run.q[start:], run.v[start:], grid.q_range, grid.v_range, grid.points, period_s
        )
        for run in runs
    ]
    seen = visited(where)
    # One unit of either network is then one torque limit.
    inertia = float(np.mean([run.inertia.mean() for run in runs]))
    unit = np.concatenate([np.full(m, torque_limit / inertia), np.ones(m)])
    folds = []
    for run in runs:
        table, residual = columns(run, grid.basis, start, every)
        folds.append(Fold.of(table * (unit / torque_limit), residual / torque_limit))
    found = choose(folds, np.concatenate([seen, seen]))
    weights = found.weights * unit
    q = np.concatenate([run.q[start:] for run in runs])
    v = np.concatenate([run.v[start:] for run in runs])
    span = grid.q_range[1] - grid.q_range[0]
    return Trained(
        w_fo=weights[:m],
        w_go=weights[m:],
        visited=seen,
        q_seen=float(np.ptp(q)) / span,
        v_seen=float(np.abs(v).max()) / grid.v_range,
        choice=found,
    )
