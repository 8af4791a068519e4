"""Dynamics of a closed-form plant as a whole."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dftc_rt.dynamics.closed_form.plants import ClosedForm

Array = npt.NDArray[np.float64]


class ClosedFormBody:
    """M(q) q̈ + bias(q, q̇) of a closed form. Every result is a new array."""

    def __init__(self, form: ClosedForm) -> None:
        """Compile for writable arrays of one row, which is what the loop hands over."""
        self._form = form
        q, v, a = np.zeros((3, form.n))
        self.inverse_dynamics(q, v, a)
        self.forward_dynamics(q, v, a)
        self.mass_matrix(q)

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Torque (n,) Nm at q (n,) rad, v (n,) rad/s and a (n,) rad/s^2."""
        out = np.empty(self._form.n)
        self._form.inverse_dynamics(q, v, a, out)
        return out

    def forward_dynamics(self, q: Array, v: Array, tau: Array) -> Array:
        """Acceleration (n,) rad/s^2 under the torque ``tau`` (n,) Nm."""
        out = np.empty(self._form.n)
        self._form.forward_dynamics(q, v, tau, out)
        return out

    def mass_matrix(self, q: Array) -> Array:
        """M (n, n), kg m^2, symmetric."""
        out = np.empty((self._form.n, self._form.n))
        self._form.mass_matrix(q, out)
        return out
