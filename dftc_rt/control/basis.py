"""Radial basis functions of (6), (7): centres, and σ(x) of one joint.

The networks for f and g of a joint share one set of basis functions, as in both of the
paper's examples; their weights are separate.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dftc_rt.control.interface import F64

_CACHE = {"cache": True, "fastmath": False}


def diagonal_centres(n: int) -> F64:
    """Centres c_k = (c, c) for c = -3 … 3, the same for every joint.

    Args:
        n: Number of joints.

    Returns:
        Centres, (n, 7, 2), in rad and rad/s.

    Source: [zhao2017] section 5.
    """
    line = np.arange(-3.0, 4.0)
    return np.ascontiguousarray(np.broadcast_to(np.stack([line, line], axis=1), (n, 7, 2)))


def grid_centres(lower: F64, upper: F64, speed: F64, count_q: int, count_v: int) -> F64:
    """Centres on a grid over each joint's own range of position and velocity.

    Args:
        lower: Lower position limits, (n,), rad.
        upper: Upper position limits, (n,), rad.
        speed: Velocity limits, (n,), rad/s.
        count_q: Grid points along the position.
        count_v: Grid points along the velocity.

    Returns:
        Centres, (n, count_q * count_v, 2), in rad and rad/s.
    """
    n = lower.shape[0]
    centres = np.empty((n, count_q * count_v, 2))
    for i in range(n):
        along_q = _line(lower[i], upper[i], count_q)
        along_v = _line(-speed[i], speed[i], count_v)
        grid_q, grid_v = np.meshgrid(along_q, along_v, indexing="ij")
        centres[i, :, 0] = grid_q.ravel()
        centres[i, :, 1] = grid_v.ravel()
    return centres


def _line(low: float, high: float, count: int) -> F64:
    """Evenly spaced points that include both ends; the middle for one point."""
    return np.linspace(low, high, count) if count > 1 else np.array([0.5 * (low + high)])


@njit(**_CACHE)
def gaussian(
    x1: float, x2: float, centres: F64, inv_width1: float, inv_width2: float, out: F64
) -> None:
    """σ_k = exp(-½ [((x1 - c_k1)/b1)² + ((x2 - c_k2)/b2)²]).

    Args:
        x1: Position, rad.
        x2: Velocity, rad/s.
        centres: Centres of this joint, (m, 2).
        inv_width1: 1/b1, 1/rad.
        inv_width2: 1/b2, s/rad.
        out: σ(x), (m,), written.

    Source: [zhao2017] section 5, with b1 = b2 = b = 0.5.
    """
    for j in range(out.shape[0]):
        d1 = (x1 - centres[j, 0]) * inv_width1
        d2 = (x2 - centres[j, 1]) * inv_width2
        out[j] = math.exp(-0.5 * (d1 * d1 + d2 * d2))


@njit(**_CACHE)
def network(weights: F64, sigma: F64) -> float:
    """Ŵᵀσ.

    Args:
        weights: Ŵ, (m,).
        sigma: σ(x), (m,).

    Source: [zhao2017] eq. (6), (7).
    """
    total = 0.0
    for j in range(sigma.shape[0]):
        total += weights[j] * sigma[j]
    return total


@njit(**_CACHE)
def weight_rate(weight: float, sigma: float, drive: float, leak: float) -> float:
    """Ŵ̇_k = drive σ_k - leak Ŵ_k.

    ``drive`` is Γ_f s in (11), Γ_g s u in (12), Γ_fo e_2o in (21) and Γ_go e_2o u in (22).

    Args:
        weight: Ŵ_k.
        sigma: σ_k(x).
        drive: Factor in front of σ.
        leak: σ-modification, 1/s; 0 in the paper.

    Source: [zhao2017] eq. (11), (12), (21), (22); the leakage is ours.
    """
    return drive * sigma - leak * weight


@njit(**_CACHE)
def adapt(weights: F64, sigma: F64, drive: float, leak: float, bound: float, period: float) -> None:
    """One explicit step of :func:`weight_rate`, projected to |Ŵ_k| ≤ bound.

    Args:
        weights: Ŵ, (m,), updated in place.
        sigma: σ(x), (m,).
        drive: Factor in front of σ.
        leak: σ-modification, 1/s.
        bound: Bound on each weight.
        period: Step, s.

    Source: [zhao2017] eq. (11), (12), (21), (22).
    """
    for j in range(sigma.shape[0]):
        w = weights[j] + period * weight_rate(weights[j], sigma[j], drive, leak)
        weights[j] = min(max(w, -bound), bound)
