"""What one run of the law in discrete time came to."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Literal

from dftc_rt.paper.discrete_cases import Group, Scope

Outcome = Literal["diverges", "chatters", "strays", "runs"]

TRACKING_RAD: Final = 0.1
"""Tracking error of a joint, RMS in a window, beyond which a run strays: a tenth of the largest
starting error."""
CHATTER: Final = 0.01
"""Change of the torque from cycle to cycle, RMS in a window, as a fraction of the torque limit,
beyond which a run chatters."""


@dataclass(frozen=True)
class Row:
    """One run, summarised. Pairs are per joint.

    Attributes:
        group: ``cumulative``, ``without`` (one left out), ``factor`` (a value times ½ or 2) or
            ``other``.
        example: 1 or 2.
        scope: ``controller`` (identifier and gain off) or ``whole``.
        step_s: Control period, s.
        on: Regularisations that were on.
        label: What was left out, or is special.
        duration_s: Length that was asked for, s.
        outcome: ``diverges``: not finite, |e| > 10 rad, torque > 1e6 Nm or |ρ̂| > 1e3.
            ``chatters``: the torque changes from cycle to cycle by more than :data:`CHATTER`.
            ``strays``: the error is above :data:`TRACKING_RAD`. ``runs``: none of these.
        diverged_s: When it diverged, s; else None.
        first: Signal that was first beyond its limit, with its joint; None if none was.
        before_rad: Tracking RMS in the window before the fault, rad; None if not reached.
        after_rad: Tracking RMS from the settling time after the fault on, rad.
        torque_nm: Largest torque as told, Nm.
        change_nm: Change of the torque from cycle to cycle, RMS of the worse window, Nm.
        rho_error: ρ̂ - ρ, RMS after the fault.
        settings: Settings of what is on, see docs/notation.md; ``torque_limit``, Nm, besides.
    """

    group: Group
    example: int
    scope: Scope
    step_s: float
    on: tuple[str, ...]
    label: str
    duration_s: float
    outcome: Outcome
    diverged_s: float | None
    first: str | None
    before_rad: tuple[float, float] | None
    after_rad: tuple[float, float] | None
    torque_nm: tuple[float, float]
    change_nm: tuple[float, float] | None
    rho_error: tuple[float, float] | None
    settings: dict[str, Any] = field(default_factory=dict)
