"""The true robot's dynamics as a closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import PlantTable
from dftc_rt.dynamics.closed_form.plants import ClosedForm
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]


class ClosedFormDynamics:
    """Compiled equations; each result lies in an array that the next call overwrites."""

    def __init__(self, form: ClosedForm, plant: PlantTable) -> None:
        """Take the equations and compile them.

        Args:
            form: The closed form.
            plant: What is true besides.

        Raises:
            InputError: A payload or armature, which the equations have no place for.
        """
        refuse_additions(form, plant)
        n = form.n
        self._form = form
        self._a, self._bias, self._zero = np.zeros((3, n))
        self._mass = np.zeros((n, n))
        q = np.zeros(n)
        self.acceleration(q, q, q)
        self.mass_matrix(q)
        self.bias(q, q)

    def acceleration(self, q: F64, v: F64, tau: F64, added: F64 | None = None) -> F64:
        """Acceleration, (n,), rad/s^2, with every joint free, under the torque (n,), Nm.

        ``added``, (n,), kg m^2, is inertia of each joint for this once.
        """
        if added is None:
            self._form.forward_dynamics(q, v, tau, self._a)
            return self._a
        M = self.mass_matrix(q) + np.diag(added)
        self._a[:] = np.linalg.solve(M, tau - self.bias(q, v))
        return self._a

    def mass_matrix(self, q: F64) -> F64:
        """M, (n, n), kg m^2, symmetric."""
        self._form.mass_matrix(q, self._mass)
        return self._mass

    def bias(self, q: F64, v: F64) -> F64:
        """Torque, (n,), Nm, that keeps every velocity as it is."""
        self._form.inverse_dynamics(q, v, self._zero, self._bias)
        return self._bias


def refuse_additions(form: ClosedForm, plant: PlantTable) -> None:
    """Refuse what changes a rigid body and cannot change a closed form.

    Raises:
        InputError: A payload, or armature.
    """
    found = f"with the closed-form plant '{form.name}'"
    if plant.payload_kg > 0.0:
        raise InputError("rig.plant.payload_kg", f"found {plant.payload_kg:g} {found}", "0")
    if plant.armature is not None and np.any(plant.armature):
        raise InputError("rig.plant.armature", f"found {plant.armature} {found}", "0")
