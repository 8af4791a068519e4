"""Attribution: what explains the residual of one joint since its anomaly began?

Four explanations of e = y - φ compete, each a weighted least-squares fit to the last seconds:

    actuator loss      e = -(1 - ρ) φ            ρ constant
    payload change     e = -m w                  w: torque of one more kilogram at the last link,
                                                 with all joints at their desired motion
    disturbance        e = d + ḋ t               any smooth additive torque
    friction change    e = c tanh(v_d / v_s)

All fits come from one matrix of weighted moments of (e, φ, w, 1, t, tanh, φ t), which forgets
exponentially. An explanation's misfit is the sum of squares that it leaves, above what noise
and a few percent of model error would leave anyway; the evidence for one against another is
N/2 times the logarithm of the ratio of their misfits, N counting independent samples. It needs
no exact variance: what is wrong with the model is wrong for all explanations.

While φ, w and t hardly move apart, all fit alike and none wins. The actuator loss may then be
asked for by a test torque, :mod:`dftc_rt.control.probe`, whose outcome adds to its evidence.
"""

from __future__ import annotations

import math
from typing import Any, Final

from numba import njit

from dftc_rt.control.interface import F64
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    ANOMALY,
    DISTURBANCE,
    PAYLOAD_CHANGE,
    UNKNOWN,
)

_CACHE = {"cache": True, "fastmath": False}

V_FRICTION: Final = 0.02
"""Velocity over which the friction of the fourth explanation changes sign, rad/s."""
MOMENTS: Final = 7
"""Signals whose moments are kept: e, φ, w, 1, t, tanh, φ t."""
_E, _PHI, _W, _ONE, _T, _FRICTION, _PHI_T = range(MOMENTS)

EVERY_S: Final = 0.005  # samples closer than this tell nothing new behind the filter of φ and y
_COLOUR_S: Final = 0.1  # errors of the model stay about this long: one independent sample
_SETTLED: Final = 0.3  # misfit that noise leaves anyway, in variances
_MODEL_ERROR: Final = 0.1  # of the residual itself, for every explanation
_RESIDUAL_S: Final = 0.25  # over which that is averaged
_LOSS_STD: Final = 0.6
_LOSS_SLOPE_STD: Final = 0.5  # 1/s
_ADDITIVE_STD: Final = 0.2  # of the torque limit
_FRICTION_STD: Final = 0.03  # of the torque limit
_EFFORT_S: Final = 0.5
_LEAST_LOSS: Final = 0.08
_SUPPORT: Final = 1.0  # nats that tests have to add to the evidence for a loss
_UNTESTED: Final = 2.0  # times the margin, where test torques are switched off
_UNKNOWN_S: Final = 2.0
_UNKNOWN_FIT: Final = 9.0  # variances that the best explanation of an unknown anomaly leaves


@njit(**_CACHE)
def begin(x: Any, moments: F64, phi: float) -> None:
    """Start all explanations anew.

    Args:
        x: State.
        moments: (7, 7), zeroed.
        phi: φ, Nm.
    """
    moments[:] = 0.0
    x.h_loss = x.h_load = 0.0
    x.ev_loss = x.ev_held = 0.0
    x.ev_load = x.ev_add = x.load_not_loss = x.add_not_loss = 0.0
    x.misfit = 0.0
    x.e_square = 0.0
    x.window = 0.0
    x.effort = phi * phi
    x.since = 0.0
    x.spare = 0.0


@njit(**_CACHE)
def explain(
    p: Any,
    x: Any,
    moments: F64,
    e: float,
    phi: float,
    load: float,
    friction: float,
    variance: float,
    h: float,
) -> None:
    """Let one sample speak to all explanations.

    Args:
        p: Parameters.
        x: State.
        moments: (7, 7), updated.
        e: y - φ, filtered, Nm.
        phi: φ, filtered, Nm.
        load: w, filtered like φ, Nm/kg.
        friction: tanh(v_d / v_s), filtered likewise.
        variance: Variance of e, Nm².
        h: Time since the last sample, s.
    """
    x.effort += (phi * phi - x.effort) * min(h / _EFFORT_S, 1.0)
    x.e_square += (e * e - x.e_square) * min(h / min(x.since + h, _RESIDUAL_S), 1.0)
    x.since += h
    x.spare += h
    if x.spare < EVERY_S:
        return
    keep = math.exp(-x.spare / p.attribution_window_s)
    x.window = keep * x.window + x.spare
    backwards(moments, x.spare)
    # A sample stands for the time since the last one, whatever the rate of the loop.
    weight = x.spare / EVERY_S / (variance + _MODEL_ERROR * _MODEL_ERROR * x.e_square)
    z = (e, phi, load, 1.0, 0.0, friction, 0.0)
    for a in range(MOMENTS):
        for b in range(MOMENTS):
            moments[a, b] = keep * moments[a, b] + weight * z[a] * z[b]
    x.spare = 0.0
    compare(p, x, moments)


@njit(**_CACHE)
def backwards(moments: F64, h: float) -> None:
    """Move the origin of t by ``h`` seconds: t is 0 now, and so less than 0 for what has been."""
    for b in range(MOMENTS):
        moments[_T, b] -= h * moments[_ONE, b]
        moments[_PHI_T, b] -= h * moments[_PHI, b]
    for a in range(MOMENTS):
        moments[a, _T] -= h * moments[a, _ONE]
        moments[a, _PHI_T] -= h * moments[a, _PHI]


@njit(**_CACHE)
def one(moments: F64, a: int, prior: float) -> tuple[float, float]:
    """Fit e = θ z_a.

    Args:
        moments: (7, 7).
        a: Signal.
        prior: Weight of θ = 0, in units of ``moments``.

    Returns:
        θ, and the weighted sum of squares left.
    """
    theta: float = moments[_E, a] / (moments[a, a] + prior)
    return theta, moments[_E, _E] - theta * moments[_E, a]


@njit(**_CACHE)
def two(moments: F64, a: int, b: int, prior_a: float, prior_b: float) -> float:
    """Weighted sum of squares that e = θ z_a + η z_b leaves; arguments as of :func:`one`."""
    aa, bb, ab = moments[a, a] + prior_a, moments[b, b] + prior_b, moments[a, b]
    det = aa * bb - ab * ab
    if det <= 1e-12 * aa * bb:
        _, alone = one(moments, a, prior_a)
        return float(alone)
    theta = (moments[_E, a] * bb - moments[_E, b] * ab) / det
    eta = (moments[_E, b] * aa - moments[_E, a] * ab) / det
    left: float = moments[_E, _E] - theta * moments[_E, a] - eta * moments[_E, b]
    return left


@njit(**_CACHE)
def compare(p: Any, x: Any, moments: F64) -> None:
    """Fit all explanations and weigh them against each other."""
    limit = p.limit
    colour = _COLOUR_S / EVERY_S
    theta, loss = one(moments, _PHI, colour / (_LOSS_STD * _LOSS_STD))
    mass, load = one(moments, _W, colour / (p.load_std_kg * p.load_std_kg))
    _, friction = one(moments, _FRICTION, colour / (_FRICTION_STD * limit) ** 2)
    add = two(
        moments,
        _ONE,
        _T,
        colour / (_ADDITIVE_STD * limit) ** 2,
        colour / (p.slope_std * limit) ** 2,
    )
    moving = two(
        moments, _PHI, _PHI_T, colour / (_LOSS_STD * _LOSS_STD), colour / _LOSS_SLOPE_STD**2
    )
    x.h_loss, x.h_load = -theta, -mass
    samples = x.window / EVERY_S
    least = _SETTLED * samples
    half = 0.5 * x.window / _COLOUR_S
    loss, load, add, friction, moving = (
        max(loss, 0.0) + least, max(load, 0.0) + least, max(add, 0.0) + least,
        max(friction, 0.0) + least, max(moving, 0.0) + least,
    )  # fmt: skip
    additive = min(add, friction)
    x.ev_loss = half * math.log(min(additive, load) / loss)
    x.ev_held = half * math.log(min(additive, load) / min(loss, moving))
    x.ev_load, x.load_not_loss = half * math.log(additive / load), half * math.log(loss / load)
    x.ev_add, x.add_not_loss = half * math.log(load / additive), half * math.log(loss / additive)
    x.misfit = min(min(loss, load), additive) / max(samples, 1.0)


@njit(**_CACHE)
def suspect(p: Any, x: Any) -> bool:
    """Whether a loss is worth asking about: enough torque, of which enough seems to be missing."""
    return bool(x.effort > (p.load_fraction * p.limit) ** 2 and x.h_loss > _LEAST_LOSS)


@njit(**_CACHE)
def explained_by_load(p: Any, x: Any, tested: float) -> bool:
    """Whether a payload change is now the best explanation by half the margin."""
    return bool(min(x.ev_load, x.load_not_loss - tested) > 0.5 * p.attribution_margin)


@njit(**_CACHE)
def verdict(p: Any, x: Any, tested: float, before: float) -> float:
    """What the evidence says now, a value of :data:`dftc_rt.control.signals.VERDICTS`.

    Args:
        p: Parameters.
        x: State.
        tested: What test torques add to the evidence for a loss, nats.
        before: Verdict of the last cycle: what has been attributed stays until something else
            explains better.
    """
    if x.since < p.attribution_s:
        return ANOMALY if before != ACTUATOR_LOSS else before
    if before == ACTUATOR_LOSS and x.ev_held + tested > 0.0:
        return ACTUATOR_LOSS
    if (
        p.probe > 0.0 and x.probe_wait < math.inf
    ):  # a closed loop alone shows losses where there are none: ask first
        enough = tested > _SUPPORT and x.ev_loss + tested > p.attribution_margin
    else:
        enough = x.ev_loss > _UNTESTED * p.attribution_margin
    if enough and suspect(p, x):
        return ACTUATOR_LOSS
    if explained_by_load(p, x, tested):
        return PAYLOAD_CHANGE
    # A test says that no torque is lost, not what else it is: it counts against a loss alone.
    if min(x.ev_add, x.add_not_loss - tested) > 0.5 * p.attribution_margin:
        return DISTURBANCE
    if x.since > _UNKNOWN_S and x.misfit > _UNKNOWN_FIT:
        return UNKNOWN
    return before if before in (PAYLOAD_CHANGE, DISTURBANCE) else ANOMALY
