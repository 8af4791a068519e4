"""Dynamics of a URDF as a whole, for the baselines and the tests. C is the Christoffel one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dftc_rt.dynamics.model import Robot

Array = npt.NDArray[np.float64]


class WholeBody:
    """M(q) q̈ + C(q, q̇) q̇ + G(q), armature included. Every result is a new array.

    Not for two threads at once: the work data is shared by the methods.
    """

    def __init__(self, robot: Robot) -> None:
        """Prepare the work data of a robot."""
        self._robot = robot
        self._model = robot.model
        self._data = robot.model.createData()
        self._x = np.zeros(robot.model.nq)

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Torque (n,) Nm at q (n,) rad, v (n,) rad/s and a (n,) rad/s^2."""
        tau: Array = pin.rnea(self._model, self._data, self._configuration(q), v, a)
        return tau

    def forward_dynamics(self, q: Array, v: Array, tau: Array) -> Array:
        """Acceleration (n,) rad/s^2 under the torque ``tau`` (n,) Nm."""
        a: Array = pin.aba(self._model, self._data, self._configuration(q), v, tau)
        return a

    def mass_matrix(self, q: Array) -> Array:
        """M (n, n), kg m^2, symmetric."""
        M: Array = pin.crba(self._model, self._data, self._configuration(q))
        return M

    def coriolis_matrix(self, q: Array, v: Array) -> Array:
        """C (n, n), Nm s/rad, with Ṁ = C + Cᵀ."""
        C: Array = pin.computeCoriolisMatrix(self._model, self._data, self._configuration(q), v)
        return C

    def gravity(self, q: Array) -> Array:
        """G (n,), Nm."""
        G: Array = pin.computeGeneralizedGravity(self._model, self._data, self._configuration(q))
        return G

    def _configuration(self, q: Array) -> Array:
        return self._robot.configuration(q, self._x)
