"""Friction as the controller believes it, from a calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from dftc_rt.dynamics.interface import JointTerms
from dftc_rt.dynamics.surrogate import Interconnection

Array = npt.NDArray[np.float64]

STICTION_RAD_S: Final = 0.01
"""Velocity over which Coulomb friction changes sign: fc tanh(v / this)."""


@njit(cache=True)
def _add(v: Array, viscous: Array, coulomb: Array, offset: Array, out: Array) -> None:
    for i in range(out.shape[0]):
        out[i] += viscous[i] * v[i] + coulomb[i] * np.tanh(v[i] / STICTION_RAD_S) + offset[i]


@dataclass(frozen=True, eq=False)
class Friction:
    """fv q̇ + fc tanh(q̇ / v_s) + fo of n joints.

    Attributes:
        viscous: fv, (n,), Nm s/rad.
        coulomb: fc, (n,), Nm.
        offset: fo, (n,), Nm.
    """

    viscous: Array
    coulomb: Array
    offset: Array

    def add_to(self, torque: Array, v: Array) -> None:
        """Add the friction torque at ``v`` (n,), rad/s, to ``torque`` (n,), Nm. Real-time safe.

        The controller takes the *desired* velocity: its sign is known, while that of a
        measured one is noise near standstill, where the sign is all that matters.
        """
        _add(v, self.viscous, self.coulomb, self.offset, torque)


class TermsWithFriction:
    """Local terms with the friction torque in the bias.

    Attributes:
        inertia: Those of the terms inside.
        bias: The same, friction added.
        load: Those of the terms inside.
        interconnection: The setting.
    """

    def __init__(self, terms: JointTerms, friction: Friction) -> None:
        """Share the arrays of ``terms`` and compile."""
        self._terms = terms
        self._friction = friction
        self.interconnection: Interconnection = terms.interconnection
        self.inertia = terms.inertia
        self.bias = terms.bias
        self.load = terms.load
        friction.add_to(np.zeros_like(self.bias), np.zeros_like(self.bias))

    def update(self, q: Array, v: Array, qd: Array, vd: Array, ad: Array) -> None:
        """Rewrite ``inertia`` and ``bias``, arguments as of the terms inside."""
        self._terms.update(q, v, qd, vd, ad)
        self._friction.add_to(self.bias, vd)
