"""The decentralised law (3)-(14) of one joint, printed and robust forms from one set of blocks.

Every robust element disappears at a stated value of its setting: ``layer`` 0 gives the exact
sgn, ``dead_zone`` 0, ``leak_*`` 0 and infinite bounds give the printed adaptation.
"""

from __future__ import annotations

import math

from numba import njit

_CACHE = {"cache": True, "fastmath": False}
SAT = 0
TANH = 1


@njit(**_CACHE)
def sliding(lam: float, e1: float, e2: float) -> float:
    """Sliding variable s = λ e + ė, rad/s.

    Args:
        lam: λ, 1/s.
        e1: e = q - q_d, rad.
        e2: ė = v - v_d, rad/s.

    Source: [zhao2017] eq. (3), (4).
    """
    return lam * e1 + e2


@njit(**_CACHE)
def interconnection_bound(s: float, bound: float) -> float:
    """S = 1 + |s| + s², at most ``bound``; also E of the identifier with s = e_2o.

    Source: [zhao2017] section 3.1 (S_i) and 3.2 (E_i).
    """
    return min(1.0 + abs(s) + s * s, bound)


@njit(**_CACHE)
def switching(s: float, layer: float, shape: int) -> float:
    """sgn(s), or its boundary layer: sat(s/layer) (shape 0) or tanh(s/layer) (shape 1).

    Args:
        s: Argument, rad/s.
        layer: Width of the layer, rad/s; 0 gives the exact sgn with sgn(0) = 0.
        shape: SAT or TANH.
    """
    if layer <= 0.0:
        return 1.0 if s > 0.0 else (-1.0 if s < 0.0 else 0.0)
    if shape == TANH:
        return math.tanh(s / layer)
    return min(max(s / layer, -1.0), 1.0)


@njit(**_CACHE)
def magnitude(s: float, dead_zone: float) -> float:
    """|s| beyond a dead zone of the stated half-width, rad/s: max(|s| - dead_zone, 0)."""
    return max(abs(s) - dead_zone, 0.0)


@njit(**_CACHE)
def torque(
    k: float,
    lam: float,
    s: float,
    e2: float,
    acc_d: float,
    f_hat: float,
    g_hat: float,
    robust: float,
) -> float:
    """Law u = -(k s + f̂ + robust - q̈_d + λ ė)/ĝ, Nm.

    Args:
        k: Feedback gain, 1/s.
        lam: λ, 1/s.
        s: Sliding variable, rad/s.
        e2: ė, rad/s.
        acc_d: q̈_d, rad/s².
        f_hat: f̂(x), rad/s².
        g_hat: ĝ(x), 1/(kg m²).
        robust: (δ̂ S + ξ̂) sgn(s), rad/s², from :func:`robust_term`.

    Source: [zhao2017] eq. (10).
    """
    return -(k * s + f_hat + robust - acc_d + lam * e2) / g_hat


@njit(**_CACHE)
def robust_term(delta: float, xi: float, big_s: float, sgn: float) -> float:
    """(δ̂ S + ξ̂) sgn(s), rad/s².

    Source: [zhao2017] eq. (10), its third and last terms.
    """
    return (delta * big_s + xi) * sgn


@njit(**_CACHE)
def bound_step(value: float, drive: float, leak: float, bound: float, period: float) -> float:
    """One explicit step of ẇ = drive - leak w, projected to [0, bound].

    ``drive`` is Γ_δ |s| S in (13), Γ_ξ |s| in (14) and Γ_δo |e_2o| E in (23), with |·| taken
    beyond the dead zone.

    Args:
        value: δ̂, ξ̂ or δ̂_o, rad/s².
        drive: Rate without leakage, rad/s³.
        leak: σ-modification, 1/s.
        bound: Upper bound, rad/s².
        period: Step, s.

    Source: [zhao2017] eq. (13), (14), (23).
    """
    return min(max(value + period * (drive - leak * value), 0.0), bound)


@njit(**_CACHE)
def drift(inertia: float, bias: float, correction: float) -> float:
    """f̂ = -bias/M + Ŵᵀσ, rad/s²; the split of (36) plus the RBF correction.

    Source: [zhao2017] eq. (36) and (6).
    """
    return -bias / inertia + correction


@njit(**_CACHE)
def input_gain(inertia: float, correction: float, g_min: float, g_max: float) -> float:
    """ĝ = clip(1 + Ŵᵀσ, g_min, g_max)/M, 1/(kg m²); never zero when g_min > 0.

    Source: [zhao2017] eq. (36) and (7); the projection is ours.
    """
    return min(max(1.0 + correction, g_min), g_max) / inertia
