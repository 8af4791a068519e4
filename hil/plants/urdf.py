"""The true robot's dynamics from its URDF, with the payload and armature that are true."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from dftc_rt.config.scenario import PlantTable
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.payload import with_armature, with_payload
from hil.plants.per_joint import per_joint

F64 = NDArray[np.float64]


class UrdfDynamics:
    """Articulated-body algorithm and composite rigid bodies.

    Source: pinocchio.aba, crba, nonLinearEffects.
    """

    def __init__(self, robot: Robot, plant: PlantTable) -> None:
        """Change the controller's model to what is true.

        Args:
            robot: What the controller believes; it is not changed.
            plant: Payload and armature.

        Raises:
            InputError: A per-joint value has the wrong length.
        """
        model = robot.model
        if plant.payload_kg > 0:
            model = with_payload(robot, plant.payload_kg, plant.payload_com_m)
        if plant.armature is not None:
            model = with_armature(model, per_joint(plant.armature, robot.n, "rig.plant.armature"))
        self._model = model
        self._data = model.createData()
        self._configuration = robot.configuration
        self._direct = model.nq == model.nv

    def acceleration(self, q: F64, v: F64, tau: F64) -> F64:
        """Acceleration, (n,), rad/s^2, with every joint free, under the torque (n,), Nm."""
        x = q if self._direct else self._configuration(q)
        a: F64 = pin.aba(self._model, self._data, x, v, tau)
        return a

    def mass_matrix(self, q: F64) -> F64:
        """M, (n, n), kg m^2, symmetric."""
        M = pin.crba(self._model, self._data, self._configuration(q))
        full: F64 = np.triu(M) + np.triu(M, 1).T
        return full

    def bias(self, q: F64, v: F64) -> F64:
        """Torque, (n,), Nm, that keeps every velocity as it is."""
        h: F64 = pin.nonLinearEffects(self._model, self._data, self._configuration(q), v)
        return h
