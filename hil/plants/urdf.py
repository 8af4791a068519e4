"""The true robot's dynamics from its URDF, with the payloads and armature that are true."""

from __future__ import annotations

from collections.abc import Sequence

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
        if plant.payload_kg > 0:
            model = with_payload(robot, plant.payload_kg, plant.payload_com_m)
        else:  # a copy all the same, because loads come and go
            model = robot.model.copy()
        if plant.armature is not None:
            model = with_armature(model, per_joint(plant.armature, robot.n, "rig.plant.armature"))
        self._model = model
        self._armature: F64 = model.armature  # the model's own memory
        self._true_armature = self._armature.copy()
        self._carried: dict[int, pin.Inertia] = {}  # links that carry something: without it
        self._data = model.createData()
        self._configuration = robot.configuration
        self._direct = model.nq == model.nv

    def acceleration(self, q: F64, v: F64, tau: F64, added: F64 | None = None) -> F64:
        """Acceleration, (n,), rad/s^2, with every joint free, under the torque (n,), Nm.

        ``added``, (n,), kg m^2, is inertia of each joint for this once.
        """
        x = q if self._direct else self._configuration(q)
        if added is None:
            a: F64 = pin.aba(self._model, self._data, x, v, tau)
            return a
        np.add(self._true_armature, added, out=self._armature)
        a = pin.aba(self._model, self._data, x, v, tau)
        self._armature[:] = self._true_armature
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

    def carry(self, loads: Sequence[tuple[int, float, F64]]) -> None:
        """Fix point masses to links, in the place of those that were fixed before.

        Args:
            loads: Of each the index of the joint that moves the link, the mass, kg, and its
                place in the link's frame, (3,), m.
        """
        for index, bare in self._carried.items():
            self._model.inertias[index] = bare
        self._carried = {}
        for joint, mass_kg, com in loads:
            index = joint + 1
            self._carried.setdefault(index, pin.Inertia(self._model.inertias[index]))
            self._model.inertias[index] += pin.Inertia(mass_kg, com, np.zeros((3, 3)))

    def add_contact(self, q: F64, joint: int, force: F64, tau: F64) -> None:
        """Add the torque of a force on a link's origin, J^T f, to ``tau``, (n,), Nm.

        Args:
            q: Position, (n,), rad.
            joint: Index of the joint that moves the link.
            force: In the base frame, (3,), N.
            tau: Torque on the joints; changed.
        """
        pin.computeJointJacobians(self._model, self._data, self._configuration(q))
        J = pin.getJointJacobian(self._model, self._data, joint + 1, pin.LOCAL_WORLD_ALIGNED)
        tau += force @ J[:3]
