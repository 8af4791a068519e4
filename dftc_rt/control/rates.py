"""Right-hand sides of one joint, put together from the blocks.

The kernel takes explicit steps of them once a cycle; the continuous closed loop of
``dftc_rt/paper`` hands them to a solver. ``p`` is one record of
:data:`dftc_rt.control.layout.PARAMETERS`.
"""

from __future__ import annotations

from typing import Any, Final

from numba import njit

from dftc_rt.control import identifier, law, observer

_CACHE = {"cache": True, "fastmath": False}
SPLIT: Final = 0
"""Value of the setting ``model``: f̂, ĝ from the split plus RBF; 1: from the RBF alone."""


@njit(**_CACHE)
def models(p: Any, inertia: float, bias: float, wf: float, wg: float) -> tuple[float, float]:
    """f̂ and ĝ from the split and the RBF outputs, or from the latter alone (printed form).

    Source: [zhao2017] eq. (6), (7), (36).
    """
    if p.model == SPLIT:
        return (
            law.drift(inertia, bias, wf),
            law.input_gain(inertia, wg, p.g_min, p.g_max),
        )
    return wf, min(max(wg, p.g_min), p.g_max)


@njit(**_CACHE)
def torque(
    p: Any, s: float, e2: float, acc_d: float, f_hat: float, g_hat: float, delta: float, xi: float
) -> float:
    """Law (10): u, Nm.

    Args:
        p: Parameters.
        s: Sliding variable, rad/s.
        e2: ė, rad/s.
        acc_d: q̈_d, rad/s².
        f_hat: f̂, rad/s².
        g_hat: ĝ, 1/(kg m²), not 0.
        delta: δ̂, rad/s².
        xi: ξ̂, rad/s².
    """
    sgn = law.switching(s, p.layer, p.layer_shape)
    robust = law.robust_term(delta, xi, law.interconnection_bound(s, p.s_bound), sgn)
    u: float = law.torque(p.k, p.lam, s, e2, acc_d, f_hat, g_hat, robust)
    return u


@njit(**_CACHE)
def bound_drives(p: Any, s: float) -> tuple[float, float]:
    """Γ_δ |s| S of (13) and Γ_ξ |s| of (14), rad/s³."""
    size = law.magnitude(s, p.dead_zone)
    big_s = law.interconnection_bound(s, p.s_bound)
    return (
        law.interconnection_drive(p.gamma_delta, size, big_s),
        law.approximation_drive(p.gamma_xi, size),
    )


@njit(**_CACHE)
def weight_drives(p: Any, s: float, u: float) -> tuple[float, float]:
    """Γ_f s of (11) and Γ_g s u of (12), u the law before the gain."""
    return p.gamma_f * s, p.gamma_g * s * u


@njit(**_CACHE)
def identifier_correction(p: Any, e2o: float, delta_o: float) -> float:
    """δ̂_o sgn(e_2o) E + l_2 e_2o of (18), rad/s²."""
    sgn = law.switching(e2o, p.layer_o, p.layer_shape)
    big_e = law.interconnection_bound(e2o, p.s_bound)
    corr: float = identifier.correction(delta_o, big_e, sgn, p.l2, e2o)
    return corr


@njit(**_CACHE)
def identifier_bound_drive(p: Any, e2o: float) -> float:
    """Γ_δo |e_2o| E of (23), rad/s³."""
    size = law.magnitude(e2o, p.dead_zone_o)
    big_e = law.interconnection_bound(e2o, p.s_bound)
    drive: float = law.interconnection_drive(p.gamma_delta_o, size, big_e)
    return drive


@njit(**_CACHE)
def identifier_weight_drives(p: Any, e2o: float, u: float) -> tuple[float, float]:
    """Γ_fo e_2o of (21) and Γ_go e_2o u of (22), u as applied."""
    return p.gamma_fo * e2o, p.gamma_go * e2o * u


@njit(**_CACHE)
def observer_rates(
    p: Any,
    rho: float,
    x1fo: float,
    x2fo: float,
    x1: float,
    x2: float,
    f_o: float,
    g_o: float,
    u: float,
    corr1: float,
    corr2: float,
) -> tuple[float, float, float]:
    """Rates of x̂_1fo, rad/s, x̂_2fo, rad/s², and ρ̂, 1/s: (28) and (29) as printed.

    Args:
        p: Parameters.
        rho: ρ̂.
        x1fo: x̂_1fo, rad.
        x2fo: x̂_2fo, rad/s.
        x1: x̂_1f of (27), or the measured position, rad.
        x2: x̂_2f of (27), or the measured velocity, rad/s.
        f_o: f̂_o, rad/s².
        g_o: ĝ_o, 1/(kg m²).
        u: Torque as told to the drive, Nm.
        corr1: l_1 e_1o, rad/s, or 0.
        corr2: δ̂_o sgn(e_2o) E + l_2 e_2o, rad/s², or 0.
    """
    e1f, e2f = x1 - x1fo, x2 - x2fo
    rate1, rate2 = observer.copy_rates(rho, x2fo, e1f, e2f, f_o, g_o, u, corr1, corr2, p.l1f, p.l2f)
    return rate1, rate2, observer.rho_rate(e2f, g_o, u, p.gamma_rho)
