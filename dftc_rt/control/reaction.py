"""What one joint makes of its estimate: verdict, gain, and the torque added meanwhile."""

from __future__ import annotations

import math
from typing import Any, Final

from numba import njit

from dftc_rt.control import attribution, decision, gain
from dftc_rt.control.signals import ACTUATOR_LOSS, ANOMALY, HEALTHY, NOT_OBSERVABLE

_CACHE = {"cache": True, "fastmath": False}

HYPOTHESES: Final = 1
"""Value of the setting ``attribution``: competing explanations; 0: the CUSUM alone."""


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
def attribute(p: Any, x: Any, observable: bool) -> None:
    """Verdict in two stages: anomaly by CUSUM, then what explains it best."""
    top = max(max(x.loss, x.excess), max(x.more, x.less))
    if x.active == 0 and top >= p.threshold_anomaly:
        x.active = 1
        attribution.begin(p, x, x.phi_f)
        x.rho_var = max(x.rho_var, p.rho_std_max * p.rho_std_max)
    elif x.active == 1 and top <= 0.0:
        x.active = 0
    before = x.verdict
    now = HEALTHY if observable else NOT_OBSERVABLE
    if x.active == 1:
        now = attribution.verdict(p, x)
        if now == ANOMALY and before != HEALTHY and before != NOT_OBSERVABLE:
            now = before  # what has been attributed stays, until something else explains better
    elif before == ACTUATOR_LOSS:
        now = before
    if now == ACTUATOR_LOSS and before == ACTUATOR_LOSS and x.clear_for >= p.clear_s:
        now = HEALTHY
        x.loss = x.excess = x.more = x.less = 0.0
        x.active = 0
    if (before == ACTUATOR_LOSS) != (now == ACTUATOR_LOSS):
        x.clear_for = 0.0
    x.verdict = now


@njit(**_CACHE)
def amplify(p: Any, x: Any, u: float) -> float:
    """Move the gain (33) and the additive compensation; returns the torque before the gain.

    Until an anomaly is attributed, the torque that is missing is added, which is right to first
    order for a loss and for a disturbance alike. When the gain moves, the sum is handed over
    without a step.

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
    x.added = before * (u + x.added) / x.gain - u
    missing = 0.0
    if x.verdict != HEALTHY and x.verdict != NOT_OBSERVABLE:
        missing = x.phi_f / x.gain - x.y_f
    bound = p.compensation * p.limit
    step = (min(max(missing, -bound), bound) - x.added) * min(p.k * p.period, 1.0)
    most = p.compensation_rate * p.limit * p.period
    x.added = min(max(x.added + min(max(step, -most), most), -bound), bound)
    total: float = u + x.added
    return total
