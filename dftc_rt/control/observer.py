"""Estimation of the effectiveness ρ of one joint from what its drive measures and was told.

The joint obeys M q̈ + bias = ρ u, so with φ the torque that a healthy drive would have delivered
and y = M q̈ + bias, both through the same filter,

    y = ρ φ + noise.

:func:`kalman` and :func:`gradient` estimate ρ from (φ, y) and share one signature; recursive
least squares with forgetting is the Kalman filter with :func:`fade` for :func:`predict`.
``printed`` is (28), (29) as the paper has them, with the measured velocity in the place of (27).
"""

from __future__ import annotations

import math

from numba import njit

_CACHE = {"cache": True, "fastmath": False}
KALMAN = 0
GRADIENT = 1
PRINTED = 2
RLS = 3
RHO_TOP = 1.2
"""Largest ρ̂ kept inside."""


@njit(**_CACHE)
def lagged(applied: float, u: float, mean_weight: float, decay: float) -> tuple[float, float]:
    """Drive torque over one period under the command u, first-order lag T.

    Args:
        applied: Torque at the start of the period, Nm.
        u: Command held over the period, Nm.
        mean_weight: (T/h)(1 - exp(-h/T)).
        decay: exp(-h/T).

    Returns:
        Mean over the period, and value at its end, Nm.
    """
    gap = applied - u
    return u + gap * mean_weight, u + gap * decay


@njit(**_CACHE)
def required(inertia: float, dv: float, elapsed: float, bias: float) -> float:
    """Torque that explains the motion of the last interval: y = M Δv/Δt + bias, Nm.

    With M and bias at the middle of the interval this is Δ(M v)/Δt - Ṁ v + bias, the momentum
    form, without computing Ṁ.

    Args:
        inertia: M at the middle of the interval, kg m².
        dv: Change of measured velocity, rad/s.
        elapsed: Length of the interval, s.
        bias: Bias at the middle of the interval, Nm.

    Source: [zhao2017] eq. (36), solved for ρ u.
    """
    return inertia * dv / elapsed + bias


@njit(**_CACHE)
def residual_variance(
    floor: float,
    noise: float,
    inertia: float,
    acc_d: float,
    acc_gap: float,
    bias: float,
    v: float,
    sigma_acc: float,
    sigma_transient: float,
    sigma_bias: float,
    sigma_friction: float,
    v_friction: float,
) -> float:
    """Variance of y - ρ φ, Nm², as a sum of independent causes.

    Args:
        floor: Residual floor of the model, Nm.
        noise: Velocity noise times the filter's bandwidth, rad/s².
        inertia: M, kg m².
        acc_d: q̈_d, rad/s².
        acc_gap: Filtered acceleration minus filtered q̈_d, rad/s²; large in a transient, when
            the other joints are away from their desired motion as well.
        bias: Bias, Nm.
        v: Velocity, rad/s.
        sigma_acc: Relative error of M q̈_d.
        sigma_transient: Relative error of M times ``acc_gap``.
        sigma_bias: Relative error of the bias.
        sigma_friction: Error of the friction at standstill, Nm.
        v_friction: Velocity at which that error has fallen to exp(-1), rad/s.
    """
    a = noise * inertia
    b = sigma_acc * inertia * acc_d
    c = sigma_transient * inertia * acc_gap
    d = sigma_bias * bias
    ratio = v / v_friction
    f = sigma_friction * math.exp(-ratio * ratio)
    return floor * floor + a * a + b * b + c * c + d * d + f * f


@njit(**_CACHE)
def kalman(
    rho: float,
    aux: float,
    phi: float,
    y: float,
    variance: float,
    speed: float,
    _damping: float,
    _floor: float,
    period: float,
) -> tuple[float, float]:
    """Scalar Kalman filter of ρ on y = ρ φ, ρ a random walk.

    Args:
        rho: ρ̂.
        aux: Variance P of ρ̂ after the time update.
        phi: Regressor φ, Nm.
        y: Measurement, Nm.
        variance: Variance of one measurement, coloured noise included, Nm².
        speed: Not used: the random walk enters by :func:`predict`, also while ρ̂ is held.
        period: Step, s.

    Returns:
        ρ̂ in [0, 1.2], and P.
    """
    gain = aux * phi / (phi * phi * aux + variance)
    rho = rho + gain * (y - rho * phi)
    return min(max(rho, 0.0), RHO_TOP), max(aux * (1.0 - gain * phi), 0.0)


@njit(**_CACHE)
def predict(var: float, walk: float, period: float, top: float) -> float:
    """Time update of the variance: P + walk² h, at most ``top``.

    Args:
        var: P.
        walk: Random walk of ρ, 1/√s.
        period: Step, s.
        top: Bound on P.
    """
    return min(var + walk * walk * period, top)


@njit(**_CACHE)
def fade(var: float, memory_s: float, period: float, top: float) -> float:
    """Exponential forgetting of recursive least squares: P exp(h/T), at most ``top``.

    Args:
        var: P.
        memory_s: T: old samples weigh exp(-age/T).
        period: Step, s.
        top: Bound on P, without which it grows for ever while nothing is observed.

    Source: [goodwin1984] section 3.3.
    """
    return min(var * math.exp(period / memory_s), top)


@njit(**_CACHE)
def normalised_rate(error: float, phi: float, speed: float, floor: float) -> float:
    """ρ̂̇ = Γ_ρ ε φ/(φ² + floor²), 1/s: (29) with a speed that does not depend on the torque.

    Args:
        error: ε = e_2f/ĝ in Nm s with φ = u in Nm, or e_2f in rad/s with φ = ĝ u in rad/s².
        phi: Regressor.
        speed: Γ_ρ, 1/s²: the loop's natural frequency squared.
        floor: φ below which the normalisation fades.

    Source: [zhao2017] eq. (29); the normalisation is ours.
    """
    return speed * error * phi / (phi * phi + floor * floor)


@njit(**_CACHE)
def gradient(
    rho: float,
    aux: float,
    phi: float,
    y: float,
    _variance: float,
    speed: float,
    damping: float,
    floor: float,
    period: float,
) -> tuple[float, float]:
    """Observer (28) on measured signals without identifier terms, and (29) normalised by (ĝ u)².

    Written for the momentum error ε = e_2f/ĝ, in which ĝ cancels:
    ε̇ = y - ρ̂ φ - l_2f ε,  ρ̂̇ = Γ_ρ ε φ/(φ² + floor²).

    Args:
        rho: ρ̂.
        aux: ε, Nm s.
        phi: Torque of a healthy drive over the last interval, unfiltered, Nm.
        y: Torque that explains the motion, unfiltered, Nm.
        speed: Γ_ρ, 1/s²: the loop's natural frequency squared.
        damping: l_2f, 1/s.
        floor: Torque below which the normalisation fades, Nm.
        period: Step, s.

    Returns:
        ρ̂ in [0, 1.2], and ε.

    Source: [zhao2017] eq. (28), (29); the normalisation is ours.
    """
    aux = aux + period * (y - rho * phi - damping * aux)
    rho = rho + period * normalised_rate(aux, phi, speed, floor)
    return min(max(rho, 0.0), RHO_TOP), aux


@njit(**_CACHE)
def faulty_rate(rho: float, f_o: float, g_o: float, u: float, corr: float) -> float:
    """x̂̇_2f = f̂_o + ĝ_o ρ u + correction, rad/s²; its first line is that of (18).

    The identified system with the fault contains ρ, which is what is looked for: it exists in
    a simulation only. On a robot the measured state takes its place.

    Args:
        rho: True ρ.
        f_o: f̂_o, rad/s².
        g_o: ĝ_o, 1/(kg m²).
        u: Torque as told to the drive, Nm.
        corr: Identifier correction δ̂_o sgn(e_2o) E + l_2 e_2o, rad/s².

    Source: [zhao2017] eq. (27).
    """
    return f_o + g_o * rho * u + corr


@njit(**_CACHE)
def copy_rates(
    rho: float,
    x2fo: float,
    e1f: float,
    e2f: float,
    f_o: float,
    g_o: float,
    u: float,
    corr1: float,
    corr2: float,
    l1f: float,
    l2f: float,
) -> tuple[float, float]:
    """x̂̇_1fo, rad/s, and x̂̇_2fo, rad/s².

    Args:
        rho: ρ̂.
        x2fo: x̂_2fo, rad/s.
        e1f: e_1f, rad.
        e2f: e_2f, rad/s.
        f_o: f̂_o, rad/s².
        g_o: ĝ_o, 1/(kg m²).
        u: Torque as told to the drive, Nm.
        corr1: l_1 e_1o of the identifier, or 0 to leave it out, rad/s.
        corr2: δ̂_o sgn(e_2o) E + l_2 e_2o of the identifier, or 0 to leave it out, rad/s².
        l1f: l_1f ≥ ½, 1/s.
        l2f: l_2f ≥ ½, 1/s.

    Source: [zhao2017] eq. (28).
    """
    return x2fo + corr1 + l1f * e1f, f_o + g_o * rho * u + corr2 + l2f * e2f


@njit(**_CACHE)
def rho_rate(e2f: float, g_o: float, u: float, gamma_rho: float) -> float:
    """ρ̂̇ = Γ_ρ e_2f ĝ_o u, 1/s.

    Source: [zhao2017] eq. (29).
    """
    return gamma_rho * e2f * g_o * u
