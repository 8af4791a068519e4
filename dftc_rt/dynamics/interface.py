"""What the dynamics of a robot offer, whether a URDF or a closed form is behind them."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from dftc_rt.dynamics.surrogate import Interconnection

Array = npt.NDArray[np.float64]


class JointTerms(Protocol):
    """Local terms of every joint, as they run in the loop.

    Attributes:
        inertia: (n,) M_i, kg m^2; rewritten in place.
        bias: (n,) C_i q̇_i + G_i + Z_i with q̈_i = 0, Nm; rewritten in place.
        load: (n,) torque that one more kilogram at the last link needs with all joints at
            their desired motion, Nm/kg; rewritten in place.
        interconnection: Where the other joints are put.

    Source: [zhao2017] eq. (36).
    """

    interconnection: Interconnection
    inertia: Array
    bias: Array
    load: Array

    def update(self, q: Array, v: Array, qd: Array, vd: Array, ad: Array) -> None:
        """Rewrite ``inertia`` and ``bias``. Real-time safe.

        Args:
            q: (n,) measured, rad.
            v: (n,) measured, rad/s.
            qd: (n,) desired, rad.
            vd: (n,) desired, rad/s.
            ad: (n,) desired, rad/s^2.
        """
        ...


class EquationsOfMotion(Protocol):
    """M(q) q̈ + bias(q, q̇) = u of the whole robot. Every result is a new array."""

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Torque (n,) Nm at q (n,) rad, v (n,) rad/s and a (n,) rad/s^2."""
        ...

    def forward_dynamics(self, q: Array, v: Array, tau: Array) -> Array:
        """Acceleration (n,) rad/s^2 under the torque ``tau`` (n,) Nm."""
        ...

    def mass_matrix(self, q: Array) -> Array:
        """M (n, n), kg m^2, symmetric."""
        ...


class LagrangianTerms(Protocol):
    """M(q) q̈ + C(q, q̇) q̇ + G(q) = u, term by term. Every result is a new array."""

    def mass_matrix(self, q: Array) -> Array:
        """M (n, n), kg m^2, symmetric."""
        ...

    def coriolis_matrix(self, q: Array, v: Array) -> Array:
        """C (n, n), Nm s/rad, the Christoffel one: Ṁ = C + Cᵀ."""
        ...

    def gravity(self, q: Array) -> Array:
        """G (n,), Nm."""
        ...
