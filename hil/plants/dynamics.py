"""How the true robot accelerates: its URDF's dynamics, or a closed form."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import PlantTable
from dftc_rt.dynamics.model import Robot
from hil.plants.closed_form import ClosedFormDynamics
from hil.plants.urdf import UrdfDynamics

F64 = NDArray[np.float64]


class ForwardDynamics(Protocol):
    """M(q) a + bias(q, v) = tau. A result may be overwritten by the next call."""

    def acceleration(self, q: F64, v: F64, tau: F64, added: F64 | None = None) -> F64:
        """Acceleration, (n,), rad/s^2, with every joint free, under the torque (n,), Nm.

        ``added``, (n,), kg m^2, is inertia of each joint for this once.
        """
        ...

    def mass_matrix(self, q: F64) -> F64:
        """M, (n, n), kg m^2, symmetric."""
        ...

    def bias(self, q: F64, v: F64) -> F64:
        """Torque, (n,), Nm, that keeps every velocity as it is."""
        ...


def forward_dynamics(robot: Robot, plant: PlantTable) -> ForwardDynamics:
    """Return the dynamics of the true robot.

    Args:
        robot: What the controller believes.
        plant: What is true: payload, armature.

    Raises:
        InputError: A per-joint value has the wrong length, or a closed form has no place for it.
    """
    if robot.closed_form is None:
        return UrdfDynamics(robot, plant)
    return ClosedFormDynamics(robot.closed_form, plant)
