"""Example 1: two inverted pendulums joined by a hard spring, as printed and as physics has it.

The paper's (34) is

    m l² θ̈_i - m g l sin θ_i + b θ̇_i - F a cos(θ_i - β) = ρ_i δ_i u_i

and its state form, which its simulation uses, is

    θ̈_i = 5.88 sin θ_i - 0.036 θ̇_i + 4 F a cos(θ_i - β) + u_i .

The two disagree: with the stated m, l, g and δ, (34) gives 19.6 sin θ_i and 4 u_i. And both
print +F a cos(θ_i - β) in the second line too, so that the spring pushes both pendulums the
same way. ``state_form`` is the second equation as printed. ``physical`` is (34) with the
spring's torque derived from its potential energy: equal and opposite forces at its ends.

Source: [zhao2017] eq. (34) and the state form below it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

F64 = NDArray[np.float64]

MASS: Final = 1.0
"""m, kg."""
LENGTH: Final = 0.5
"""l, m."""
DISTANCE: Final = 1.0
"""l_0, distance of the pivots and rest length of the spring, m."""
GRAVITY: Final = 9.8
"""g, m/s²."""
DAMPING: Final = 0.009
"""b, Nm s/rad."""
STIFFNESS: Final = 30.0
"""k, N/m."""
HARDENING: Final = 0.1
"""A, 1/m."""
ARM: Final = 0.1
"""a, where the spring is attached, m from the pivot."""
INERTIA: Final = MASS * LENGTH * LENGTH
"""m l², kg m²."""

STATE_GRAVITY: Final = 5.88
"""Coefficient of sin θ in the printed state form, rad/s²."""
STATE_DAMPING: Final = 0.036
"""Coefficient of θ̇ in the printed state form, 1/s."""


@njit(cache=True)
def spring(q1: float, q2: float) -> tuple[float, float, float]:
    """Spring between the pendulums.

    Args:
        q1: θ_1, rad from the upright.
        q2: θ_2, rad.

    Returns:
        Tension F, N; its direction β, rad; its length l_k, m.

    Source: [zhao2017] below eq. (34).
    """
    along = DISTANCE - ARM * math.sin(q1) + ARM * math.sin(q2)
    across = ARM * math.cos(q1) - ARM * math.cos(q2)
    length = math.sqrt(along * along + across * across)
    stretch = length - DISTANCE
    tension = STIFFNESS * (1.0 + HARDENING * HARDENING * stretch * stretch) * stretch
    return tension, math.atan2(across, along), length


@njit(cache=True)
def state_form_inverse_dynamics(q: F64, v: F64, a: F64, out: F64) -> None:
    """Torque of the printed state form, unit input gain.

    Args:
        q: θ, (2,), rad.
        v: θ̇, (2,), rad/s.
        a: θ̈, (2,), rad/s².
        out: u, (2,), Nm on an inertia of 1 kg m², written.
    """
    tension, beta, _ = spring(q[0], q[1])
    for i in range(2):
        drift = STATE_GRAVITY * math.sin(q[i]) - STATE_DAMPING * v[i]
        out[i] = a[i] - drift - tension * ARM * math.cos(q[i] - beta) / INERTIA


@njit(cache=True)
def state_form_forward_dynamics(q: F64, v: F64, tau: F64, out: F64) -> None:
    """θ̈ of the printed state form under the torque ``tau``, arguments as above."""
    tension, beta, _ = spring(q[0], q[1])
    for i in range(2):
        drift = STATE_GRAVITY * math.sin(q[i]) - STATE_DAMPING * v[i]
        out[i] = drift + tension * ARM * math.cos(q[i] - beta) / INERTIA + tau[i]


@njit(cache=True)
def state_form_mass_matrix(q: F64, out: F64) -> None:
    """M (2, 2) of the printed state form: 1 kg m² each."""
    out[:] = 0.0
    out[0, 0] = out[1, 1] = 1.0


@njit(cache=True)
def physical_inverse_dynamics(q: F64, v: F64, a: F64, out: F64) -> None:
    """Torque of the physical pair, Nm.

    Args:
        q: θ, (2,), rad.
        v: θ̇, (2,), rad/s.
        a: θ̈, (2,), rad/s².
        out: u, (2,), Nm, written.
    """
    tension, beta, _ = spring(q[0], q[1])
    for i in range(2):
        pull = (1.0 - 2.0 * i) * tension * ARM * math.cos(q[i] - beta)
        weight = MASS * GRAVITY * LENGTH * math.sin(q[i])
        out[i] = INERTIA * a[i] - weight + DAMPING * v[i] - pull


@njit(cache=True)
def physical_forward_dynamics(q: F64, v: F64, tau: F64, out: F64) -> None:
    """θ̈ of the physical pair under the torque ``tau``, arguments as above."""
    tension, beta, _ = spring(q[0], q[1])
    for i in range(2):
        pull = (1.0 - 2.0 * i) * tension * ARM * math.cos(q[i] - beta)
        weight = MASS * GRAVITY * LENGTH * math.sin(q[i])
        out[i] = (tau[i] + weight - DAMPING * v[i] + pull) / INERTIA


@njit(cache=True)
def physical_mass_matrix(q: F64, out: F64) -> None:
    """M (2, 2) of the physical pair: m l² each."""
    out[:] = 0.0
    out[0, 0] = out[1, 1] = INERTIA


def physical_energy(q: F64, v: F64) -> float:
    """Kinetic and potential energy of the physical pair, J.

    Its gradient is what ties ``physical`` to Newton's third law; the printed signs have no
    potential.

    Args:
        q: θ, (2,), rad.
        v: θ̇, (2,), rad/s.
    """
    _, _, length = spring(q[0], q[1])
    stretch = length - DISTANCE
    stored = STIFFNESS * (0.5 * stretch**2 + 0.25 * HARDENING**2 * stretch**4)
    height = MASS * GRAVITY * LENGTH * (math.cos(q[0]) + math.cos(q[1]))
    kinetic = 0.5 * INERTIA * (v[0] * v[0] + v[1] * v[1])
    return float(kinetic + height + stored)
