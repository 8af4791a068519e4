"""Weights of one joint by ridge regression, its strength chosen on runs that were left out.

The adaptive law (21), (22) is a gradient descent on the squared identification error: where the
regressor is persistently exciting it converges to the least-squares weights, and its leakage, of
which the paper has none, is what ridge is here. Least squares gets there in one step, has no gain
that decides how far training went, and lets the strength of the ridge be chosen by what an
adaptation cannot see: the error on a run that the weights were not fitted to. When no strength
makes that error smaller, the weights are 0.

Source: [zhao2017] eq. (21), (22); [hoerl1970].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

STRENGTHS: Final = tuple(float(x) for x in np.logspace(-6.0, 0.0, 13))
"""Candidates for the ridge, relative to torques in parts of the limit."""
LEAST_GAIN: Final = 0.02
"""By this part the RMS of runs left out has to fall, or the weights are 0."""
AS_GOOD: Final = 0.01
"""A stronger ridge is as good if the RMS of runs left out is within this part of the least."""


@dataclass(frozen=True, eq=False)
class Fold:
    """Normal equations of one run.

    Attributes:
        gram: AᵀA, (p, p).
        right: Aᵀe, (p,).
        square: eᵀe.
        rows: Their number.
    """

    gram: F64
    right: F64
    square: float
    rows: int

    @staticmethod
    def of(columns: F64, residual: F64) -> Fold:
        """Sums over the rows of a run: columns (rows, p), residual (rows,)."""
        return Fold(
            columns.T @ columns,
            columns.T @ residual,
            float(residual @ residual),
            len(residual),
        )

    def error(self, weights: F64) -> float:
        """Sum of squares that these weights leave."""
        left = self.square - 2.0 * weights @ self.right + weights @ self.gram @ weights
        return max(float(left), 0.0)


@dataclass(frozen=True, eq=False)
class Choice:
    """What cross-validation chose.

    Attributes:
        weights: (p,), in the columns' units.
        strength: Of the ridge; infinite where nothing transfers.
        with_gain: Whether the columns of Ŵ_go are used.
        left_out: RMS of the runs left out over that of the residual itself; 1 if nothing
            transfers.
    """

    weights: F64
    strength: float
    with_gain: bool
    left_out: float


def _solve(folds: Sequence[Fold], use: NDArray[np.bool_], strength: float) -> F64:
    """Ridge weights of several runs together; 0 where ``use`` is False."""
    rows = sum(fold.rows for fold in folds)
    gram = np.sum([fold.gram for fold in folds], axis=0)[np.ix_(use, use)] / rows
    right = np.sum([fold.right for fold in folds], axis=0)[use] / rows
    weights = np.zeros(len(use))
    weights[use] = np.linalg.solve(gram + strength * np.eye(int(use.sum())), right)
    return weights


def choose(folds: Sequence[Fold], use: NDArray[np.bool_]) -> Choice:
    """Weights of the strength, and of the networks, that runs left out speak for.

    Args:
        folds: Two or more, their columns in parts of the torque limit, Ŵ_fo's first.
        use: Columns that may be used, (p,): cells that were visited.
    """
    half = len(use) // 2
    f_only = use & (np.arange(len(use)) < half)
    nothing = Choice(np.zeros(len(use)), np.inf, False, 1.0)
    total = sum(fold.square for fold in folds)
    if total <= 0.0 or not use.any() or len(folds) < 2:
        return nothing
    tried = [
        (_left_out(folds, mask, strength), with_gain, strength)
        for with_gain, mask in ((False, f_only), (True, use))
        for strength in reversed(STRENGTHS)
    ]
    best = min(left for left, _, _ in tried)
    if best > (1.0 - LEAST_GAIN) ** 2 * total:
        return nothing
    # The first that is as good: the simpler network, the stronger ridge.
    left, with_gain, strength = next(x for x in tried if x[0] <= (1.0 + AS_GOOD) ** 2 * best)
    weights = _solve(folds, use if with_gain else f_only, strength)
    return Choice(weights, strength, with_gain, float(np.sqrt(left / total)))


def _left_out(folds: Sequence[Fold], use: NDArray[np.bool_], strength: float) -> float:
    """Sum of squares on each run, of weights fitted to the others."""
    return sum(
        fold.error(_solve([other for other in folds if other is not fold], use, strength))
        for fold in folds
    )
