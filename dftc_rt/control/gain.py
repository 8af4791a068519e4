"""The self-tuned gain (33) of one joint."""

from __future__ import annotations

import math

from numba import njit

_CACHE = {"cache": True, "fastmath": False}
ATTRIBUTED = 0
ALWAYS = 1


@njit(**_CACHE)
def target(rho_hat: float, rho_min: float, rho_max: float) -> float:
    """1/clip(ρ̂, ρ_min, ρ_max), dimensionless.

    Source: [zhao2017] eq. (33); the clip is ours, and wide open in the printed form.
    """
    return 1.0 / min(max(rho_hat, rho_min), rho_max)


@njit(**_CACHE)
def follow(gain: float, wanted: float, rate: float, period: float) -> float:
    """Move the gain towards the wanted one by at most ``rate * period``.

    Args:
        gain: Present gain.
        wanted: Gain to reach.
        rate: Largest slope, 1/s; infinity applies (33) at once.
        period: Step, s.
    """
    step = rate * period
    return gain + min(max(wanted - gain, -step), step)


@njit(**_CACHE)
def command(u: float, gain: float, counts: float, resolution: float, limit: float) -> float:
    """Torque as the drive is told: gain u, saturated at ±limit and rounded to its steps, Nm.

    Args:
        u: Law before the gain, Nm.
        gain: Self-tuned gain.
        counts: Largest whole number of steps within the limit.
        resolution: One step of the drive, Nm; 0 for a drive without steps.
        limit: Torque limit, Nm.
    """
    wanted = gain * u
    if resolution > 0.0:
        wanted = math.floor(min(max(wanted / resolution, -counts), counts) + 0.5) * resolution
    return min(max(wanted, -limit), limit)
