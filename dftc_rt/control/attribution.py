"""Attribution: what explains the residual of one joint since its anomaly began?

Four explanations of e = y - φ compete, each a small Kalman filter started at the anomaly:

    actuator loss      e = -(1 - ρ) φ            ρ constant, or walking slowly
    payload change     e = -m w                  w: torque of one more kilogram at the last link,
                                                 with all joints at their desired motion
    disturbance        e = d + ḋ t               any smooth additive torque
    friction change    e = c tanh(v_d / v_s)

The evidence of each is the log-likelihood of its innovations, so that an explanation pays for
its freedom. The loss wins when it beats every other by a margin: while φ and w hardly change,
nothing wins, because nothing could. Evidence is divided by how much worse than its variance the
loss fits, for residuals that are larger in a transient than calibration saw.
"""

from __future__ import annotations

import math
from typing import Any, Final

from numba import njit

from dftc_rt.control.signals import ACTUATOR_LOSS, ANOMALY, DISTURBANCE, PAYLOAD_CHANGE

_CACHE = {"cache": True, "fastmath": False}

V_FRICTION: Final = 0.02
"""Velocity over which the friction of the fourth explanation changes sign, rad/s."""
_LOSS_STD: Final = 0.5
_ADDITIVE_STD: Final = 0.2  # of the torque limit
_FRICTION_STD: Final = 0.03  # of the torque limit
_WALK: Final = 0.05  # of ρ, 1/√s
_SLOPE_WALK: Final = 0.1  # of ḋ, torque limits per s^1.5
_FIT_S: Final = 0.1
_SPREAD_S: Final = 0.3
_EFFORT_S: Final = 0.5
_LEAST_LOSS: Final = 0.08
_SIGNIFICANT: Final = 4.0  # standard deviations


@njit(**_CACHE)
def begin(p: Any, x: Any, phi: float) -> None:
    """Start all explanations anew.

    Args:
        p: Parameters.
        x: State.
        phi: φ, Nm.
    """
    limit = p.limit
    x.h_loss = x.h_load = x.h_friction = x.h_add = x.h_slope = 0.0
    x.p_loss = _LOSS_STD * _LOSS_STD
    x.p_load = p.load_std_kg * p.load_std_kg
    x.p_friction = (_FRICTION_STD * limit) ** 2
    x.p_add = (_ADDITIVE_STD * limit) ** 2
    x.p_cross = 0.0
    x.p_slope = (p.slope_std * limit) ** 2
    x.ev_loss = x.ev_load = x.ev_friction = x.ev_add = 0.0
    x.fit = 0.0
    x.spread = 1.0
    x.effort = phi * phi
    x.since = 0.0


@njit(**_CACHE)
def scalar(
    value: float, var: float, regressor: float, e: float, variance: float
) -> tuple[float, float, float, float]:
    """One step of a scalar explanation e = θ x.

    Args:
        value: θ̂.
        var: Its variance.
        regressor: x.
        e: Residual, Nm.
        variance: Variance of e, Nm².

    Returns:
        θ̂, its variance, what the innovation adds to the evidence, and the innovation, Nm.
    """
    total = regressor * regressor * var + variance
    nu = e - regressor * value
    gain = var * regressor / total
    evidence = -0.5 * (math.log(total / variance) + nu * nu / total)
    return value + gain * nu, var * (1.0 - gain * regressor), evidence, nu


@njit(**_CACHE)
def explain(
    p: Any, x: Any, e: float, phi: float, load: float, friction: float, variance: float, h: float
) -> None:
    """Let one sample speak to all explanations.

    Args:
        p: Parameters.
        x: State.
        e: y - φ, filtered, Nm.
        phi: φ, filtered, Nm.
        load: w, filtered like φ, Nm/kg.
        friction: tanh(v_d / v_s), filtered likewise.
        variance: Variance of e, inflated for colour, Nm².
        h: Time since the last sample, s.
    """
    x.p_loss += _WALK * _WALK * h
    x.h_loss, x.p_loss, gain, nu = scalar(x.h_loss, x.p_loss, -phi, e, variance)
    x.ev_loss += gain
    plain = variance / p.inflation
    ratio = nu * nu / plain
    x.fit += (ratio - x.fit) * min(h / _FIT_S, 1.0)
    x.spread += (ratio - x.spread) * min(h / _SPREAD_S, 1.0)
    x.h_load, x.p_load, gain, nu = scalar(x.h_load, x.p_load, -load, e, variance)
    x.ev_load += gain
    x.h_friction, x.p_friction, gain, nu = scalar(x.h_friction, x.p_friction, friction, e, variance)
    x.ev_friction += gain
    # additive torque with a slope
    x.h_add += h * x.h_slope
    p_add = x.p_add + 2.0 * h * x.p_cross + h * h * x.p_slope
    p_cross = x.p_cross + h * x.p_slope
    p_slope = x.p_slope + (_SLOPE_WALK * p.limit) ** 2 * h
    total = p_add + variance
    nu = e - x.h_add
    k_add, k_slope = p_add / total, p_cross / total
    x.ev_add -= 0.5 * (math.log(total / variance) + nu * nu / total)
    x.h_add += k_add * nu
    x.h_slope += k_slope * nu
    x.p_add = p_add * (1.0 - k_add)
    x.p_cross = p_cross * (1.0 - k_add)
    x.p_slope = p_slope - k_slope * p_cross
    x.effort += (phi * phi - x.effort) * min(h / _EFFORT_S, 1.0)
    x.since += h


@njit(**_CACHE)
def verdict(p: Any, x: Any) -> float:
    """What the evidence says now, a value of :data:`dftc_rt.control.signals.VERDICTS`."""
    if x.since < p.attribution_s:
        return ANOMALY
    margin = p.attribution_margin * max(x.spread, 1.0)
    other = max(x.ev_load, max(x.ev_add, x.ev_friction))
    significant = x.h_loss > max(_LEAST_LOSS, _SIGNIFICANT * math.sqrt(x.p_loss))
    loaded = x.effort > (p.load_fraction * p.limit) ** 2
    if x.ev_loss - other > margin and significant and loaded and x.fit < p.attribution_fit:
        return ACTUATOR_LOSS
    other = max(x.ev_loss, max(x.ev_add, x.ev_friction))
    if x.ev_load - other > margin and abs(x.h_load) > _SIGNIFICANT * math.sqrt(x.p_load):
        return PAYLOAD_CHANGE
    if max(x.ev_add, x.ev_friction) - max(x.ev_loss, x.ev_load) > margin:
        return DISTURBANCE
    return ANOMALY
