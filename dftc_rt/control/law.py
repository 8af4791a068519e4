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
def interconnection_drive(gamma: float, size: float, big_s: float) -> float:
    """Γ_δ |s| S, rad/s³; with |e_2o| and E the identifier's.

    Args:
        gamma: Γ_δ or Γ_δo, 1/s.
        size: |s| or |e_2o|, from :func:`magnitude`, rad/s.
        big_s: S or E.

    Source: [zhao2017] eq. (13), (23).
    """
    return gamma * size * big_s


@njit(**_CACHE)
def approximation_drive(gamma: float, size: float) -> float:
    """Γ_ξ |s|, rad/s³: drives ξ̂ towards the bound ξ of ω = ε_f + ε_g u, (8) and (9).

    Source: [zhao2017] eq. (14).
    """
    return gamma * size


@njit(**_CACHE)
def bound_rate(value: float, drive: float, leak: float) -> float:
    """Rate of δ̂, ξ̂ or δ̂_o with σ-modification: drive - leak w, rad/s³.

    Args:
        value: δ̂, ξ̂ or δ̂_o, rad/s².
        drive: From :func:`interconnection_drive` or :func:`approximation_drive`, rad/s³.
        leak: σ-modification, 1/s; 0 in the paper.

    Source: [zhao2017] eq. (13), (14), (23); the leakage is ours.
    """
    return drive - leak * value


@njit(**_CACHE)
def bound_step(value: float, drive: float, leak: float, bound: float, period: float) -> float:
    """One explicit step of :func:`bound_rate`, projected to [0, bound].

    Args:
        value: δ̂, ξ̂ or δ̂_o, rad/s².
        drive: Rate without leakage, rad/s³.
        leak: σ-modification, 1/s.
        bound: Upper bound, rad/s².
        period: Step, s.

    Source: [zhao2017] eq. (13), (14), (23).
    """
    rate: float = bound_rate(value, drive, leak)
    return min(max(value + period * rate, 0.0), bound)


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
