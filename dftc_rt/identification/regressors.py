"""What the networks multiply, filtered as the observer filters its residual.

The kernel has y - φ of the healthy robot, both sides through one first-order filter. With frozen
networks it becomes y - φ - M Ŵ_foᵀσ - (Ŵ_goᵀσ) φ under the same filter, which is linear in the
weights as long as ĝ M stays within its bounds. The columns of that regression are made here.

Source: [zhao2017] eq. (18) with x̂ = x: M ẋ_2 = M f̂_o + M ĝ_o u.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.control import basis

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Basis:
    """Gaussians of one joint.

    Attributes:
        centres: (m, 2), rad and rad/s.
        inv_width1: 1/b along the position, 1/rad.
        inv_width2: 1/b along the velocity, s/rad.
    """

    centres: F64
    inv_width1: float
    inv_width2: float


@dataclass(frozen=True, eq=False)
class Samples:
    """What one joint did in one fault-free run, K cycles.

    Attributes:
        q: (K,), rad.
        v: (K,), rad/s.
        inertia: M_i, (K,), kg m².
        y_f: Torque that the motion needed, filtered, (K,), Nm.
        phi_f: Torque that a healthy drive delivered, filtered, (K,), Nm.
        alpha: Step of the filter, 1 - exp(-bandwidth h).
    """

    q: F64
    v: F64
    inertia: F64
    y_f: F64
    phi_f: F64
    alpha: float

    def phi(self) -> F64:
        """φ before the filter, (K,), Nm; 0 in the first cycle."""
        raw = np.zeros_like(self.phi_f)
        raw[1:] = (self.phi_f[1:] - (1.0 - self.alpha) * self.phi_f[:-1]) / self.alpha
        return raw


@njit(cache=True)
def _columns(
    q: F64,
    v: F64,
    inertia: F64,
    phi: F64,
    centres: F64,
    inv_width1: float,
    inv_width2: float,
    alpha: float,
    start: int,
    every: int,
    out: F64,
) -> None:
    m = centres.shape[0]
    sigma = np.empty(m)
    last = np.zeros(m)
    state = np.zeros(2 * m)
    row = 0
    for k in range(q.shape[0]):
        if k > 0:  # the kernel observes nothing in its first cycle
            basis.gaussian(q[k], v[k], centres, inv_width1, inv_width2, sigma)
            for j in range(m):
                now = inertia[k] * sigma[j]
                state[j] += alpha * (0.5 * (now + last[j]) - state[j])
                state[m + j] += alpha * (sigma[j] * phi[k] - state[m + j])
                last[j] = now
        if k >= start and (k - start) % every == 0:
            out[row] = state
            row += 1


def columns(samples: Samples, grid: Basis, start: int, every: int) -> tuple[F64, F64]:
    """Regression of the residual on the weights, thinned out.

    Args:
        samples: One run of one joint.
        grid: Its Gaussians, m of them.
        start: First cycle that is kept.
        every: Keep one cycle in so many.

    Returns:
        Columns, (rows, 2 m): Nm per rad/s² of Ŵ_fo, then Nm per unit of Ŵ_go; and the residual
        y - φ, (rows,), Nm.
    """
    count = max(-(-(len(samples.q) - start) // every), 0)
    out = np.empty((count, 2 * grid.centres.shape[0]))
    _columns(
        np.ascontiguousarray(samples.q), np.ascontiguousarray(samples.v),
        np.ascontiguousarray(samples.inertia), samples.phi(), grid.centres, grid.inv_width1,
        grid.inv_width2, samples.alpha, start, every, out,
    )  # fmt: skip
    residual = (samples.y_f - samples.phi_f)[start::every]
    return out, np.ascontiguousarray(residual)
