r"""Friction of the true joints: viscous with Coulomb, or bristles that bend before they slip.

``friction = "coulomb"``: F = viscous v + coulomb tanh(v / V_STICK).

``friction = "lugre"``, with the bristles' deflection z:

    F = k z + c (1 - a sgn(v) z / z_s) v + viscous v,     z' = v (1 - a sgn(v) z / z_s)
    g(v) = F_c + (F_s - F_c) exp(-(v / v_s)^2),           z_s = g / k
    F_c = coulomb (1 + load_friction |tau| / tau_limit),  F_s = stribeck F_c

The stiffness k is such that static friction without load is reached at ``presliding_rad``.
Up to ELASTIC of z_s the bristles only bend (a = 0), from z_s on they slip (a = 1): a joint that
torque ripple shakes does not creep, as it does with a = 1 throughout. Sliding steadily, F is
g(v) + viscous v.

One substep takes a, g and c at its beginning, the bristle exactly for a velocity that is
constant, and that velocity at its end:

    z+ = E z + p v+,   E = exp(-x),   p = dt (1 - E) / x,   x = a |v| dt / z_s

F at the end is then linear in v+, so it adds ``dt dF/dv+`` to the joint's inertia, and no stiffness
is too large for the step. No energy comes from it either: with x >= 0,
v+ k z+ dt >= k (z+^2 - z^2) / 2, because (1 - x / (e^x - 1))^2 <= 2 x.

Source: [canudas1995] for g and z', [dupont2002] for a.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.fields import Scalars
from dftc_rt.config.scenario import PlantTable
from dftc_rt.dynamics.model import Robot
from dftc_rt.errors import InputError
from hil.plants import layout
from hil.plants.layout import (
    ADDED,
    APPLIED,
    BRISTLE,
    COULOMB,
    DECAY,
    FRICTION,
    LOAD,
    SLIP,
    STATIC,
    STIFFNESS,
    STRIBECK,
    TORQUE_LIMIT,
    VISCOUS,
)
from hil.plants.per_joint import per_joint

F64 = NDArray[np.float64]

V_STICK: Final = 0.01  # rad/s at which Coulomb friction has all but reached its value
ELASTIC: Final = 0.7  # of the deflection at which all slips: below it, nothing does
DAMPING_S: Final = 2e-3  # damping of the bristles over their stiffness, s
_SMALLEST_RAD: Final = 1e-15  # keeps the deflection's bound above 0 where friction is 0

_LUGRE_KEYS: Final = ("stribeck", "stribeck_rad_s", "presliding_rad", "load_friction")


def joint_parameters(robot: Robot, plant: PlantTable) -> F64:
    """Return what the plant's kernels need of each joint, (N_PARAMETERS, n).

    Raises:
        InputError: A per-joint value has the wrong length, friction is given twice, or a key
            has no meaning with the chosen friction.
    """
    joints = np.zeros((layout.N_PARAMETERS, robot.n))

    def row(name: str) -> F64:
        return per_joint(getattr(plant, name), robot.n, f"rig.plant.{name}")

    joints[TORQUE_LIMIT] = robot.torque_limit
    joints[layout.TORQUE_CONSTANT] = row("torque_constant")
    for place, name in ((VISCOUS, "viscous"), (COULOMB, "coulomb")):
        share = row(f"{name}_fraction")
        joints[place] = row(name)
        if share.any():
            if joints[place].any():
                found = f"found {_shown(getattr(plant, f'{name}_fraction'))} beside {name}"
                raise InputError(f"rig.plant.{name}_fraction", found, "one of the two")
            joints[place] = share * robot.torque_limit
    if plant.friction == "coulomb":
        _refuse_unused(plant)
        return joints
    if not joints[COULOMB].any():
        found = "found 'lugre', and no joint has Coulomb friction"
        raise InputError("rig.plant.friction", found, "coulomb or coulomb_fraction above 0")
    joints[STATIC], joints[STRIBECK] = row("stribeck"), row("stribeck_rad_s")
    joints[LOAD] = row("load_friction")
    joints[STIFFNESS] = joints[STATIC] * joints[COULOMB] / row("presliding_rad")
    return joints


def _refuse_unused(plant: PlantTable) -> None:
    default = PlantTable()
    for name in _LUGRE_KEYS:
        value = getattr(plant, name)
        if value != getattr(default, name):
            found = f"found {_shown(value)} with friction = 'coulomb'"
            raise InputError(f"rig.plant.{name}", found, "friction = 'lugre'")


def _shown(value: Scalars) -> str:
    return f"{value:g}" if isinstance(value, float | int) else f"{list(value)}"


@numba.njit(cache=True, error_model="numpy")
def resist(dt: float, v: F64, joints: F64, rows: F64, tau: F64) -> None:
    """Write what of the motors' torque is left to move the links. Real-time safe.

    Args:
        dt: Substep, s.
        v: Velocity at the substep's beginning, (n,), rad/s.
        joints: Parameters, (N_PARAMETERS, n).
        rows: State, (N_STATE, n); reads APPLIED, FRICTION and BRISTLE, and writes DECAY, SLIP
            and ADDED where there are bristles.
        tau: Out, (n,), Nm: where there are bristles, for a joint with ADDED more inertia.
    """
    for i in range(v.shape[0]):
        applied = rows[APPLIED, i]
        viscous = rows[FRICTION, i] * joints[VISCOUS, i]
        coulomb = rows[FRICTION, i] * joints[COULOMB, i]
        stiffness = joints[STIFFNESS, i]
        if stiffness == 0.0:
            tau[i] = applied - viscous * v[i] - coulomb * np.tanh(v[i] / V_STICK)
            continue
        coulomb *= 1.0 + joints[LOAD, i] * abs(applied) / joints[TORQUE_LIMIT, i]
        extra = (joints[STATIC, i] - 1.0) * np.exp(-((v[i] / joints[STRIBECK, i]) ** 2))
        g = coulomb * (1.0 + extra)
        most = max(g / stiffness, _SMALLEST_RAD)
        z = rows[BRISTLE, i]
        sign = np.sign(v[i])
        # Where the bristle would be at the end: at high speed it must not overshoot its bound.
        ahead = sign * (z + dt * v[i]) / most
        slipping = min(max((ahead - ELASTIC) / (1.0 - ELASTIC), 0.0), 1.0)
        x = slipping * abs(v[i]) * dt / most
        decay = np.exp(-x)
        slip = dt * (-np.expm1(-x) / x if x > 0.0 else 1.0)
        bending = max(1.0 - slipping * sign * z / most, 0.0)
        slope = stiffness * (slip + DAMPING_S * bending) + viscous
        rows[DECAY, i] = decay
        rows[SLIP, i] = slip
        rows[ADDED, i] = dt * slope
        tau[i] = applied - stiffness * decay * z - slope * v[i]


@numba.njit(cache=True)
def bend(v: F64, rows: F64) -> None:
    """Move the bristles on to the end of a substep, at which the velocity is ``v``, (n,)."""
    for i in range(v.shape[0]):
        rows[BRISTLE, i] = rows[DECAY, i] * rows[BRISTLE, i] + rows[SLIP, i] * v[i]
