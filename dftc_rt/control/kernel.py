"""One cycle of the ``dftc`` law for all joints: the blocks in order, column i at a time.

Nothing here reads a column other than the joint's own; that is what makes the law local.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

from numba import njit

from dftc_rt.control import (
    attribution,
    basis,
    decision,
    gain,
    identifier,
    law,
    observer,
    probe,
    rates,
    reaction,
)
from dftc_rt.control.interface import F64, NONFINITE_INPUT, NONFINITE_LAW, WANTS_RESPONSE
from dftc_rt.control.layout import W_F, W_FO, W_G, W_GO
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    AD,
    AGE,
    ANOMALY,
    NOT_OBSERVABLE,
    OBSERVABLE,
    QD,
    RESIDUAL,
    RHO_HAT,
    RHO_STD,
    TAU_CMD,
    TAU_LAW,
    VD,
    VERDICT,
    Q,
    S,
    V,
)

_CACHE = {"cache": True, "fastmath": False}
_DRIFT_S: Final = 0.1
"""Over which the misfit of ρ̂ is averaged, s."""
_FITS: Final = 0.4
"""Mean misfit that is no sign of a ρ that moves, in standard deviations."""


@njit(**_CACHE)
def drive_torque(p: Any, x: Any, history: F64) -> float:
    """Mean torque that a healthy drive delivered over the last interval, Nm; moves its lag on."""
    length = history.shape[0]
    u = history[(x.cycle - 1 - p.delay) % length]
    mean: float
    mean, x.applied = observer.lagged(x.applied, u, p.lag_mean, p.lag_decay)
    return mean


@njit(**_CACHE)
def identify(
    p: Any, x: Any, weights: F64, sigma: F64, q: float, v: float, f_o: float, g_o: float, u: float
) -> float:
    """Step the identifier (18), (21)-(23) over the last interval; returns its correction."""
    corr: float
    e1o = q - x.x1o
    e2o = v - x.x2o
    corr = rates.identifier_correction(p, e2o, x.delta_o)
    h = p.period
    x.x1o += h * identifier.rate1(x.x2o, p.l1, e1o)
    x.x2o += h * identifier.rate2(f_o, g_o, u, corr)
    if p.identifier == identifier.ADAPT:
        drive_f, drive_g = rates.identifier_weight_drives(p, e2o, u)
        basis.adapt(weights[W_FO], sigma, drive_f, p.leak_o, p.w_f_max, h)
        basis.adapt(weights[W_GO], sigma, drive_g, p.leak_o, p.w_g_max, h)
        drive = rates.identifier_bound_drive(p, e2o)
        x.delta_o = law.bound_step(x.delta_o, drive, p.leak_o, p.delta_o_max, h)
    return corr


@njit(**_CACHE)
def observe_printed(
    p: Any, x: Any, q: float, v: float, f_o: float, g_o: float, u: float, corr: float, e1o: float
) -> None:
    """Step (28), (29) as printed, with the measured state in the place of (27)."""
    on = p.observer_correction == 1
    rate1, rate2, rho_rate = rates.observer_rates(
        p, x.rho, x.x1fo, x.x2fo, q, v, f_o, g_o, u,
        p.l1 * e1o if on else 0.0, corr if on else 0.0,
    )  # fmt: skip
    h = p.period
    x.x1fo += h * rate1
    x.x2fo += h * rate2
    x.rho += h * rho_rate


@njit(**_CACHE)
def observe(
    p: Any,
    x: Any,
    moments: F64,
    correlations: F64,
    sums: F64,
    q: float,
    v: float,
    v_d: float,
    acc_d: float,
    inertia: float,
    bias: float,
    load: float,
    scale: float,
    fresh: bool,
) -> bool:
    """Build (φ, y) from a fresh sample, estimate ρ and feed the CUSUMs.

    Args:
        p: Parameters.
        x: State; ``phi_sum`` and ``elapsed`` cover the interval since the last fresh sample.
        moments: Of the explanations, (7, 7).
        correlations: Of the test torque, (longest, 7).
        sums: Of a running test, (2, 6), updated.
        q: Position, rad.
        v: Velocity, rad/s.
        v_d: Desired velocity, rad/s.
        acc_d: q̈_d, rad/s².
        inertia: M, kg m².
        bias: Bias with the frozen RBF correction, Nm.
        load: Torque of one more kilogram at the last link, Nm/kg.
        scale: ĝ_o M, factor of the frozen RBF correction on the torque.
        fresh: Whether this cycle brought a new measurement.

    Returns:
        Whether ρ can be observed.
    """
    h = p.period
    walk = p.walk
    if x.verdict in (ACTUATOR_LOSS, ANOMALY):
        pace = 1.0
        if p.attribution == reaction.HYPOTHESES:  # the variance is known: what fits, stands still
            pace = min(max((abs(x.drift) - _FITS) / _FITS, 0.0), 1.0)
        walk += pace * max(p.walk_fault - p.walk, 0.0)
    if p.observer == observer.KALMAN:
        top = p.rho_std_max * p.rho_std_max
        x.rho_var = observer.predict(x.rho_var, walk, h, top)
    elif p.observer == observer.RLS:
        x.rho_var = observer.fade(x.rho_var, p.rls_memory_s, h, p.rho_std_max * p.rho_std_max)
    if not fresh:
        return False
    span = h * x.elapsed
    m_mid = 0.5 * (inertia + x.m_last)
    dv = v - x.v_last
    moved = q - x.q_last - 0.5 * (v + x.v_last) * span
    x.gap_q += (moved if x.cycle > 1 else 0.0) - x.gap_q * min(span / reaction.SENSOR_S, 1.0)
    x.q_last = q
    y = observer.required(m_mid, dv, span, 0.5 * (bias + x.b_last))
    phi = scale * x.phi_sum / x.elapsed
    x.v_last, x.m_last, x.b_last = v, inertia, bias
    alpha = p.alpha if x.elapsed == 1 else 1.0 - (1.0 - p.alpha) ** x.elapsed
    x.y_f += alpha * (y - x.y_f)
    x.phi_f += alpha * (phi - x.phi_f)
    x.gap_f += alpha * (dv / span - acc_d - x.gap_f)
    x.need_f += alpha * (inertia * acc_d + bias - x.need_f)
    x.load_f += alpha * (load - x.load_f)
    x.friction_f += alpha * (math.tanh(v_d / attribution.V_FRICTION) - x.friction_f)
    if p.attribution == reaction.HYPOTHESES:
        probe.sample(p, x, sums, correlations, phi, y, v_d, x.elapsed)
    x.phi_sum = 0.0
    x.elapsed = 0
    if x.cycle < p.warmup or abs(x.phi_f) < p.excitation * p.floor:
        return False
    if p.attribution == reaction.HYPOTHESES and reaction.contradicts(p, x):
        return False
    plain = observer.residual_variance(
        p.floor, p.noise, inertia, acc_d, x.gap_f, bias, v,
        p.sigma_acc, p.sigma_transient, p.sigma_bias, p.sigma_friction * p.limit, p.v_friction,
    )  # fmt: skip
    variance = p.inflation * plain
    if p.observer in (observer.KALMAN, observer.RLS):
        misfit = (x.y_f - x.rho * x.phi_f) / math.sqrt(plain)
        x.drift += (misfit - x.drift) * min(span / _DRIFT_S, 1.0)
        x.rho, x.rho_var = observer.kalman(
            x.rho, x.rho_var, x.phi_f, x.y_f, variance, walk, 0.0, p.floor, span
        )
    elif p.observer == observer.GRADIENT:
        x.rho, x.momentum_error = observer.gradient(
            x.rho, x.momentum_error, phi, y, variance, p.gamma_rho, p.l2f, p.floor, span
        )
    below = decision.log_likelihood_ratio(x.phi_f, x.y_f, 1.0 - p.rho_step, variance)
    above = decision.log_likelihood_ratio(x.phi_f, x.y_f, 1.0 + p.rho_step, variance)
    top = 1.5 * max(p.threshold_loss, p.threshold_anomaly)
    x.loss = decision.cusum(x.loss, below, top)
    x.excess = decision.cusum(x.excess, above, top)
    if p.attribution == reaction.HYPOTHESES:
        e = x.y_f - x.phi_f
        step = p.residual_step * math.sqrt(plain)
        x.more = decision.cusum(x.more, decision.shift_ratio(e, step, variance), top)
        x.less = decision.cusum(x.less, decision.shift_ratio(-e, step, variance), top)
        if x.active == 1:
            attribution.explain(p, x, moments, e, x.phi_f, x.load_f, x.friction_f, plain, span)
    x.clear_for = decision.clearing(x.clear_for, x.rho, p.rho_clear, span)
    return True


@njit(**_CACHE)
def silence(i: int, rec: F64, x: Any, history: F64) -> None:
    """Command 0 Nm and hold the estimate: what a joint does whose numbers are not finite."""
    history[x.cycle % history.shape[0]] = 0.0
    x.cycle += 1
    rec[TAU_LAW, i] = 0.0
    rec[TAU_CMD, i] = 0.0
    rec[RHO_HAT, i] = x.rho
    rec[RHO_STD, i] = math.nan
    rec[OBSERVABLE, i] = 0.0
    rec[VERDICT, i] = x.verdict if x.verdict == ACTUATOR_LOSS else NOT_OBSERVABLE
    rec[S, i] = math.nan
    rec[RESIDUAL, i] = math.nan


@njit(**_CACHE)
def joint(
    i: int,
    rec: F64,
    m: float,
    b: float,
    load: float,
    p: Any,
    x: Any,
    w: F64,
    c: F64,
    sigma: F64,
    history: F64,
    moments: F64,
    correlations: F64,
    sums: F64,
) -> int:
    """One cycle of joint i; returns status bits."""
    q = rec[Q, i]
    v = rec[V, i]
    acc_d = rec[AD, i]
    e1 = q - rec[QD, i]
    e2 = v - rec[VD, i]
    u_last = drive_torque(p, x, history)
    x.phi_sum += u_last
    x.elapsed += 1
    bad_model = p.model == rates.SPLIT and not (math.isfinite(m) and m > 0.0 and math.isfinite(b))
    if bad_model or not math.isfinite(q + v + e1 + e2 + acc_d):
        silence(i, rec, x, history)
        return NONFINITE_INPUT
    own_b = b
    b = own_b + x.mass * load
    wf = wg = wfo = wgo = 0.0
    if p.use_basis == 1:
        basis.gaussian(q, v, c, p.inv_width1, p.inv_width2, sigma)
        wf = basis.network(w[W_F], sigma)
        wg = basis.network(w[W_G], sigma)
        wfo = basis.network(w[W_FO], sigma)
        wgo = basis.network(w[W_GO], sigma)
    # identifier (18) and observer (28), (29), or the regression y = rho phi
    f_o, g_o = rates.models(p, m, b, wfo, wgo)
    corr = 0.0
    e1o = q - x.x1o
    if p.identifier != identifier.OFF and x.cycle > 0:
        corr = identify(p, x, w, sigma, q, v, f_o, g_o, u_last)
    observable = False
    asked = 0
    if p.observer == observer.PRINTED:
        if x.cycle > 0:
            observe_printed(p, x, q, v, f_o, g_o, u_last, corr, e1o)
        residual = f_o + g_o * u_last
        observable = True
    else:
        fresh = rec[AGE, i] == 0.0 and x.cycle > 0
        v_d = rec[VD, i]
        observable = observe(
            p, x, moments, correlations, sums, q, v, v_d, acc_d, m, b - m * wfo, load, g_o * m,
            fresh,
        )  # fmt: skip
        residual = x.y_f - x.phi_f
        if p.attribution == reaction.HYPOTHESES:
            reaction.attribute(p, x, moments, observable)
            unsure = x.active == 1 and p.ftc == 1
            if not unsure:
                x.probe_at = probe.IDLE
            elif x.probe_at == probe.ASKED or probe.ask(p, x, residual, p.floor, v_d):
                asked = WANTS_RESPONSE
        else:
            reaction.decide(p, x, observable)
    # law (10), gain (33), command
    s = law.sliding(p.lam, e1, e2)
    f_hat, g_hat = rates.models(p, m, own_b + x.mass * load, wf, wg)  # may be new by now
    u = math.nan
    if g_hat != 0.0:
        u = rates.torque(p, s, e2, acc_d, f_hat, g_hat, x.delta, x.xi)
    wanted = reaction.amplify(p, x, u)
    if x.probe_at >= 0:
        wanted += probe.torque(p, x, correlations) / x.gain
    if not math.isfinite(wanted * x.gain + x.rho):
        silence(i, rec, x, history)
        return NONFINITE_LAW
    told = gain.command(wanted, x.gain, p.counts, p.resolution, p.limit)
    # adaptation (11)-(14)
    saturated = abs(x.gain * wanted) > p.limit
    if not (saturated and p.freeze_saturated == 1):
        h = p.period
        drive_delta, drive_xi = rates.bound_drives(p, s)
        x.delta = law.bound_step(x.delta, drive_delta, p.leak_delta, p.delta_max, h)
        x.xi = law.bound_step(x.xi, drive_xi, p.leak_xi, p.xi_max, h)
        if p.adapt_f == 1:
            drive_f, drive_g = rates.weight_drives(p, s, u)
            basis.adapt(w[W_F], sigma, drive_f, p.leak_f, p.w_f_max, h)
            basis.adapt(w[W_G], sigma, drive_g, p.leak_g, p.w_g_max, h)
    history[x.cycle % history.shape[0]] = told
    x.cycle += 1
    rec[TAU_LAW, i] = u
    rec[TAU_CMD, i] = told
    rec[RHO_HAT, i] = x.rho
    rec[RHO_STD, i] = (
        p.std_scale * math.sqrt(x.rho_var)
        if p.observer in (observer.KALMAN, observer.RLS)
        else math.nan
    )
    rec[OBSERVABLE, i] = 1.0 if observable else 0.0
    rec[VERDICT, i] = x.verdict
    rec[S, i] = s
    rec[RESIDUAL, i] = residual
    return asked


@njit(**_CACHE)
def skip(par: Any, st: Any, history: F64, ticks: int) -> None:
    """Account for ticks without a cycle.

    No SYNC is sent at such a tick, so the drives go on with the torque that is in force,
    and the command that was sent last waits.

    Args:
        par: Parameters, (n,).
        st: States, (n,).
        history: Commands, (n, depth), Nm.
        ticks: How many.
    """
    for i in range(par.shape[0]):
        p, x = par[i], st[i]
        for _ in range(ticks):
            x.phi_sum += drive_torque(p, x, history[i])
            x.elapsed += 1


@njit(**_CACHE)
def cycle(
    rec: F64,
    m: F64,
    b: F64,
    load: F64,
    par: Any,
    st: Any,
    w: F64,
    c: F64,
    sigma: F64,
    history: F64,
    moments: F64,
    correlations: F64,
    sums: F64,
) -> int:
    """Kernel over all joints; returns the or of their status bits."""
    status = 0
    for i in range(par.shape[0]):
        p, x = par[i], st[i]
        status |= joint(
            i, rec, m[i], b[i], load[i], p, x, w[i], c[i], sigma, history[i],
            moments[i], correlations[i], sums[i],
        )  # fmt: skip
    return status


CYCLE: Callable[..., int] = cycle
