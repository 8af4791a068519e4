"""The Lyapunov functions (15), (24), (30) of n joints, and what a smooth sgn adds to their rates.

They compare adapted quantities with ideal ones, which only a made-up plant has: W̃ = W* - Ŵ,
δ̃ = δ - δ̂, ξ̃ = ξ - ξ̂, ρ̃ = ρ - ρ̂. Arrays end in the joint axis n (weights: n, m); whatever
comes before it, time for instance, is kept. With the exact sgn, no leakage, no dead zone and no
bound in reach,

    Σ_i V̇_i  ≤ -Σ_i k_i s_i²                                        (15), the sum only
    V̇_io     ≤ -(l_1 - ½) e_1o² - (l_2 - ½) e_2o²                   (24), each joint
    V̇_if     ≤ -(l_1f - ½) e_1f² - (l_2f - ½) e_2f²                 (30), each joint

under conditions that the functions state. sgn enters the first two as -w |s| for an adapted
bound w ≥ 0. tanh(s/ε) makes that -w s tanh(s/ε), and |s| - s tanh(s/ε) = ε x (1 - tanh x) with
x = |s|/ε is at most :data:`SMOOTHING` ε; :func:`smoothing` adds it up. The factor is the
*estimate* δ̂ S + ξ̂, which (13), (14) only ever raise.

Source: [zhao2017] eq. (15), (24), (30).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.control.interface import F64, Struct
from dftc_rt.errors import InputError

SMOOTHING: Final = 0.2784645427610738
"""Largest x (1 - tanh x) over x ≥ 0."""


def tracking(par: Struct, s: F64, w_f: F64, w_g: F64, delta: F64, xi: F64) -> F64:
    """V_i of (15), (…, n), rad²/s².

    With f_i = W*_fᵀσ + ε_f, g_i = W*_gᵀσ + ε_g and ω_i = ε_f + ε_g u_i, (10) leaves

        ṡ_i = -k s_i + W̃_fᵀσ + W̃_gᵀσ u_i + ω_i + h_i - (δ̂ S_i + ξ̂) sgn s_i,

    and (11)-(14) take from s_i ṡ_i all that contains an error:

        V̇_i = -k s_i² + (s_i ω_i - ξ_i |s_i|) + (s_i h_i - δ_i |s_i| S_i).

    The second term is ≤ 0 by |ω_i| ≤ ξ_i. The third is not: with |h_i| ≤ Σ_j d_ij S_j a joint
    at rest against large S_j of others gains. Summed it is: |s_i| and S_i are ordered alike, so
    Σ_i |s_i| Σ_j S_j ≤ n Σ_i |s_i| S_i (Chebyshev), and δ_i = n max d_ij over all i **and** j
    suffices. A maximum over the row i alone does not.

    Args:
        par: Parameters, (n,) of :data:`dftc_rt.control.layout.PARAMETERS`; the rates Γ are read.
        s: Sliding variable, (…, n), rad/s.
        w_f: W̃_f, (…, n, m), rad/s².
        w_g: W̃_g, (…, n, m), 1/(kg m²).
        delta: δ̃, (…, n), rad/s².
        xi: ξ̃, (…, n), rad/s².

    Raises:
        InputError: A rate is not positive: what is not adapted has no place in (15).

    Source: [zhao2017] eq. (15).
    """
    return (
        0.5 * s**2
        + _weights(w_f, _rate(par, "gamma_f"))
        + _weights(w_g, _rate(par, "gamma_g"))
        + 0.5 * delta**2 / _rate(par, "gamma_delta")
        + 0.5 * xi**2 / _rate(par, "gamma_xi")
    )


def identification(par: Struct, e1o: F64, e2o: F64, w_fo: F64, w_go: F64, delta_o: F64) -> F64:
    """V_io of (24), (…, n), in the units of its terms: rad² and rad²/s².

    On the healthy plant (18) leaves ė_1o = e_2o - l_1 e_1o and

        ė_2o = -l_2 e_2o + W̃_foᵀσ + W̃_goᵀσ u_i + ω_i + h_i - δ̂_o E_i sgn e_2o,

    so that (21)-(23) give

        V̇_io = e_1o e_2o - l_1 e_1o² - l_2 e_2o² + (e_2o (h_i + ω_i) - δ_o |e_2o| E_i).

    e_1o e_2o ≤ ½ e_1o² + ½ e_2o² asks for l_1, l_2 ≥ ½ (l_1 l_2 ≥ ¼ is enough). The bracket is
    ≤ 0, for each joint by itself, if |h_i + ω_i| ≤ δ_o E_i; there is no ξ̂ in (18), so δ_o has
    to cover ω_i as well. |h_i| ≤ Σ_j d_ij S_j does not imply it: S_j grows with the tracking
    error s_j, E_i with the identification error e_2o, and the one may be large while the other
    is nothing. δ_o ≥ sup |h_i + ω_i| over the trajectory implies it. If |h_i| ≤ Σ_j d_ij E_j,
    the sum decreases with δ_o = n max d_ij.

    Args:
        par: Parameters, (n,).
        e1o: e_1o, (…, n), rad.
        e2o: e_2o, (…, n), rad/s.
        w_fo: W̃_fo, (…, n, m), rad/s².
        w_go: W̃_go, (…, n, m), 1/(kg m²).
        delta_o: δ̃_o, (…, n), rad/s².

    Raises:
        InputError: A rate is not positive.

    Source: [zhao2017] eq. (24).
    """
    return (
        0.5 * (e1o**2 + e2o**2)
        + _weights(w_fo, _rate(par, "gamma_fo"))
        + _weights(w_go, _rate(par, "gamma_go"))
        + 0.5 * delta_o**2 / _rate(par, "gamma_delta_o")
    )


def estimation(par: Struct, e1f: F64, e2f: F64, rho: F64) -> F64:
    """V_if of (30), (…, n), in the units of its terms: rad² and rad²/s².

    (27) less (28) is ė_1f = e_2f - l_1f e_1f, ė_2f = ĝ_o u ρ̃ - l_2f e_2f: f̂_o and the
    identifier's corrections cancel, right or wrong, and so does every sgn. With ρ constant, (29)
    gives V̇_if = e_1f e_2f - l_1f e_1f² - l_2f e_2f², whatever ĝ_o and u are. A ρ that moves
    adds ρ̃ ρ̇/Γ_ρ. That V_if falls therefore says nothing about f̂_o and ĝ_o; and with the
    measured state for (27) nothing cancels.

    Args:
        par: Parameters, (n,).
        e1f: e_1f, (…, n), rad.
        e2f: e_2f, (…, n), rad/s.
        rho: ρ̃, (…, n).

    Raises:
        InputError: The rate is not positive.

    Source: [zhao2017] eq. (30).
    """
    return 0.5 * (e1f**2 + e2f**2 + rho**2 / _rate(par, "gamma_rho"))


def smoothing(layer: F64 | float, bound: F64) -> F64:
    """Most that tanh(s/ε) for sgn adds to V̇ of (15) or (24), (…, n), rad²/s³.

    Args:
        layer: ε, scalar or (n,), rad/s; 0 for the exact sgn.
        bound: δ̂ S + ξ̂ of (10), or δ̂_o E of (18), not negative, (…, n), rad/s².
    """
    added: F64 = SMOOTHING * layer * np.asarray(bound)
    return added


def _weights(error: F64, rate: F64) -> F64:
    """½ W̃ᵀΓ⁻¹W̃ of every joint, (…, n)."""
    energy: F64 = 0.5 * np.sum(error**2, axis=-1) / rate
    return energy


def _rate(par: Struct, name: str) -> F64:
    """Γ of every joint, (n,)."""
    rate: NDArray[Any] = par[name]
    if not (rate > 0.0).all():
        raise InputError(f"control.gains.{name}", str(rate), "positive rates of adaptation")
    return rate
