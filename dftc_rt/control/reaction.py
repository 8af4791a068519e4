"""What one joint makes of its estimate: verdict, gain, and the torque added meanwhile."""

from __future__ import annotations

import math
from typing import Any, Final

from numba import njit

from dftc_rt.control import attribution, decision, gain, probe
from dftc_rt.control.interface import F64
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    HEALTHY,
    NOT_OBSERVABLE,
    PAYLOAD_CHANGE,
    SENSOR,
)

_CACHE = {"cache": True, "fastmath": False}

HYPOTHESES: Final = 1
"""Value of the setting ``attribution``: competing explanations; 0: the CUSUM alone."""
SENSOR_S: Final = 0.1
"""Memory of the comparison of position and velocity, s."""
_KEEP_S: Final = 1.0  # a payload change that has been explained for so long is a fact
_NEEDED: Final = 6.0  # residual floors of torque from which a joint must feel its motor
_SHARE: Final = 0.25  # of φ that the motion itself must need
_GROWN: Final = 1.7
_GROWTH: Final = 0.06  # of the torque limit, and what y may answer
_ANSWER: Final = 0.3  # of it
_ALL: Final = 0.95  # of the limit: φ cannot grow any more
_HANDED: Final = 0.01  # from the gain that is wanted: the hand-over is done
_POWERLESS_S: Final = 0.06  # contacts of 20 N have looked so for 51 ms


@njit(**_CACHE)
def decide(p: Any, x: Any, observable: bool) -> None:
    """Verdict, and the sums that start anew when an actuator loss begins or ends."""
    before = x.verdict
    x.verdict = decision.verdict(
        before, x.loss, x.excess, x.rho, x.clear_for, observable,
        p.threshold_anomaly, p.threshold_loss, p.rho_loss, p.clear_s,
    )  # fmt: skip
    if (before == ACTUATOR_LOSS) != (x.verdict == ACTUATOR_LOSS):
        x.clear_for = 0.0
        if before == ACTUATOR_LOSS:
            x.loss = 0.0
            x.excess = 0.0


@njit(**_CACHE)
def attribute(p: Any, x: Any, moments: F64, observable: bool) -> None:
    """Verdict in two stages: anomaly by CUSUM, then what explains it best."""
    top = max(max(x.loss, x.excess), max(x.more, x.less))
    lost = powerless(p, x)
    if x.active == 0 and (lost or top >= p.threshold_anomaly):
        x.active = 1
        attribution.begin(x, moments, x.phi_f)
        probe.forget(x)
        x.rho_var = max(x.rho_var, p.rho_std_max * p.rho_std_max)
    elif x.active == 1 and top <= 0.0 and not lost:
        x.active = 0
        probe.forget(x)
    before = x.verdict
    now = HEALTHY if observable else NOT_OBSERVABLE
    if x.active == 1:
        probe.revise(x)
        now = attribution.verdict(p, x, x.probe_evidence, before)
        if now != ACTUATOR_LOSS and lost:
            now = ACTUATOR_LOSS
            x.rho = max(min(x.y_f / x.phi_f, x.rho), 0.0)
    elif before == ACTUATOR_LOSS:
        now = before
    if now == ACTUATOR_LOSS and before == ACTUATOR_LOSS and x.clear_for >= p.clear_s:
        now = HEALTHY
        rest(x)
    if (before == ACTUATOR_LOSS) != (now == ACTUATOR_LOSS):
        x.clear_for = 0.0
        x.handing = 1
    if contradicts(p, x) and before != ACTUATOR_LOSS:  # a weak motor stays weak meanwhile
        now = SENSOR
        rest(x)
    holds = now == PAYLOAD_CHANGE and observable
    holds = holds and attribution.explained_by_load(p, x, x.probe_evidence)
    x.held_for = x.held_for + p.period if holds else 0.0
    if x.held_for >= _KEEP_S and p.ftc == 1:
        take(p, x)
        now = HEALTHY if observable else NOT_OBSERVABLE
    x.verdict = now


@njit(**_CACHE)
def contradicts(p: Any, x: Any) -> bool:
    """Whether position and velocity of this joint tell different stories."""
    return bool(abs(x.gap_q) > p.sensor_gap_rad)


@njit(**_CACHE)
def rest(x: Any) -> None:
    """Back to no suspicion: sums at zero, no anomaly."""
    x.loss = x.excess = x.more = x.less = 0.0
    x.active = 0
    x.held_for = 0.0
    x.low_for = 0.0
    probe.forget(x)


@njit(**_CACHE)
def take(p: Any, x: Any) -> None:
    """Take an attributed load into the model, so that a loss after it is seen for itself.

    At most what the compensation may add is moved from there into the bias, with the sum as it
    was. The caller has to count the new mass in this cycle's bias.
    """
    most = 3.0 * p.load_std_kg
    mass = min(max(x.mass + x.h_load, -most), most)
    change = (mass - x.mass) * x.load_f
    bound = p.compensation * p.limit
    if abs(change) > bound:
        mass = x.mass + (mass - x.mass) * bound / abs(change)
        change = math.copysign(bound, change)
    x.mass = mass
    x.y_f += change
    x.b_last += change
    x.added -= change
    rest(x)


@njit(**_CACHE)
def powerless(p: Any, x: Any) -> bool:
    """Whether the motor gives nothing at all: φ has grown, and y has not.

    Under an additive torque y grows with φ, whatever its size; without a motor it stays at
    zero, where it would be anyway if the motion needed nothing: the desired motion has to need
    torque. φ has to grow, by a share of what it was and of the limit, which the compensation sees
    to, and y must not answer: a push may cancel the motor, but hardly follow it. Or φ is at the
    limit all the while.
    """
    least = max(_NEEDED * p.floor, p.load_fraction * p.limit)
    size = abs(x.phi_f)
    needed = x.need_f if x.phi_f > 0.0 else -x.need_f
    start = size if x.low_for == 0.0 else abs(x.low_phi)
    if needed < max(least, _SHARE * start) or abs(x.y_f) > p.rho_min * size:
        x.low_for = 0.0
        return False
    if x.low_for == 0.0:
        x.low_phi = x.phi_f
        x.low_pp = x.low_py = 0.0
    x.low_for += p.period
    growth = x.phi_f - x.low_phi
    x.low_pp += growth * growth
    x.low_py += growth * x.y_f
    least = max((_GROWN - 1.0) * abs(x.low_phi), _GROWTH * p.limit)
    grown = growth * x.low_phi > 0.0 and abs(growth) > least and x.low_py < _ANSWER * x.low_pp
    return bool(x.low_for >= _POWERLESS_S and (grown or size > _ALL * p.limit))


@njit(**_CACHE)
def amplify(p: Any, x: Any, u: float) -> float:
    """Move the gain (33) and the additive compensation; returns the torque before the gain.

    Until an anomaly is attributed, the torque that is missing is added, which is right to first
    order for a loss and for a disturbance alike. When a verdict brings the gain or takes it, the
    sum is handed over without a step; afterwards the gain follows ρ̂ on its own.

    Args:
        p: Parameters.
        x: State.
        u: Law before the gain, Nm.
    """
    wanted = 1.0
    if p.ftc == 1 and (p.gain_gate == gain.ALWAYS or x.verdict == ACTUATOR_LOSS):
        wanted = gain.target(x.rho, p.rho_min, p.rho_max)
    before = x.gain
    x.gain = gain.follow(before, wanted, p.gain_rate, p.period)
    if p.attribution != HYPOTHESES or p.ftc == 0 or not math.isfinite(u):
        return u
    if x.handing == 1:
        x.added = before * (u + x.added) / x.gain - u
        x.handing = int(abs(wanted - x.gain) > _HANDED)
    missing = 0.0
    if x.verdict != HEALTHY and x.verdict != NOT_OBSERVABLE and x.verdict != SENSOR:
        missing = x.phi_f / x.gain - x.y_f
    bound = p.compensation * p.limit
    step = (min(max(missing, -bound), bound) - x.added) * min(p.k * p.period, 1.0)
    most = p.compensation_rate * p.limit * p.period
    x.added = min(max(x.added + min(max(step, -most), most), -bound), bound)
    total: float = u + x.added
    return total
