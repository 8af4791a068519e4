"""What the baselines share: a checked start, silence on bad input, the command as sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from dftc_rt.control import layout, settings
from dftc_rt.control.interface import F64, NONFINITE_LAW, InverseDynamics
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.control.signals import (
    AD,
    NOT_OBSERVABLE,
    OBSERVABLE,
    QD,
    RESIDUAL,
    RHO_HAT,
    RHO_STD,
    TAU_CMD,
    TAU_LAW,
    VD,
    VERDICT,
    Q,
    S,
    V,
)
from dftc_rt.errors import InputError

__all__ = ["AddFriction", "Baseline", "Effectiveness", "InverseDynamics", "Matrices"]

AddFriction = Callable[[F64, F64], None]
"""(torque, v): adds the calibrated friction at v (n,), rad/s, to torque (n,), Nm."""

Effectiveness = Callable[[float, F64], None]
"""(t, out): writes the true ρ of every joint at t seconds after the start to out (n,)."""


class Matrices(Protocol):
    """Terms of M(q) q̈ + C(q, q̇) q̇ + G(q) = u of the whole robot; every result is a new array."""

    def mass_matrix(self, q: F64) -> F64:
        """M (n, n), kg m², symmetric, armature included, at q (n,), rad."""
        ...

    def coriolis_matrix(self, q: F64, v: F64) -> F64:
        """C (n, n), Nm s/rad, the Christoffel one: Ṁ = C + Cᵀ."""
        ...

    def gravity(self, q: F64) -> F64:
        """G (n,), Nm."""
        ...


class Baseline:
    """Common part of the baselines.

    Attributes:
        ftc: Whether an estimate acts on the command.
        uses_local_terms: Whether ``inertia`` and ``bias`` are read.
        parameters: Settings and what follows from them, (n,) of
            :data:`dftc_rt.control.layout.PARAMETERS`; the same as those of the law ``dftc``.
        history: Commands sent, (n, length), Nm, a ring over the cycle number.
    """

    def __init__(
        self,
        joints: Joints,
        gains: Mapping[str, Value],
        add_friction: AddFriction | None = None,
        *,
        ftc: bool = False,
        uses_local_terms: bool = False,
    ) -> None:
        """Allocate.

        Args:
            joints: Robot and drives.
            gains: Keys of :data:`dftc_rt.control.settings.NAMES`.
            add_friction: Friction of a calibrated robot; None: none is assumed.
            ftc: Whether an estimate acts on the command.
            uses_local_terms: Whether ``inertia`` and ``bias`` are read.

        Raises:
            InputError: A gain is unknown or out of bounds.
        """
        n = joints.torque_limit.shape[0]
        store = layout.allocate(settings.parse(gains, n, printed=False), joints, ftc=ftc)
        self.ftc = ftc
        self.uses_local_terms = uses_local_terms
        self.parameters = store.parameters
        self.history = store.history
        self._lam: F64 = self.parameters["lam"].copy()
        self._k: F64 = self.parameters["k"].copy()
        self._limit = joints.torque_limit
        self._stepped = joints.torque_resolution > 0.0
        self._resolution = np.where(self._stepped, joints.torque_resolution, 1.0)
        self._counts: F64 = self.parameters["counts"].copy()
        self._add_friction = add_friction

    def start(self, q: F64, v: F64) -> None:
        """Check the measured pose and forget what was sent; a law with states resets them.

        Args:
            q: Measured positions, (n,), rad.
            v: Measured velocities, (n,), rad/s.

        Raises:
            InputError: A shape is wrong or a value is not finite.
        """
        n = self._limit.shape[0]
        for name, values in (("q", q), ("v", v)):
            if np.shape(values) != (n,) or not np.all(np.isfinite(values)):
                raise InputError(f"start {name}", str(values), f"{n} finite values")
        self.history[:] = 0.0

    def skip(self, ticks: int) -> None:
        """Ticks without a cycle: nothing to account for where there is no memory."""

    def told(self, joint: int, tau: float) -> None:
        """Another command was sent: nothing to correct where there is no memory of it."""

    def _begin(self, rec: F64) -> bool:
        """Write what a law without an estimate says, and s; whether the inputs are finite."""
        rec[RHO_HAT] = math.nan
        rec[RHO_STD] = math.nan
        rec[OBSERVABLE] = 0.0
        rec[VERDICT] = NOT_OBSERVABLE
        rec[RESIDUAL] = math.nan
        rec[TAU_LAW] = 0.0
        rec[TAU_CMD] = 0.0
        if not np.isfinite(rec[: AD + 1]).all():
            rec[S] = math.nan
            return False
        rec[S] = self._lam * (rec[Q] - rec[QD]) + (rec[V] - rec[VD])
        return True

    def _send(self, rec: F64, u: F64, wanted: F64) -> int:
        """Write the law's torque u and the wanted one as the drives will be told it.

        Args:
            rec: The record.
            u: Torque of the law, (n,), Nm.
            wanted: The same with the estimate applied, (n,), Nm.

        Returns:
            Status bits.
        """
        if not np.isfinite(wanted).all():
            return NONFINITE_LAW
        rec[TAU_LAW] = u
        steps = np.clip(wanted / self._resolution, -self._counts, self._counts)
        told = np.where(self._stepped, np.floor(steps + 0.5) * self._resolution, wanted)
        rec[TAU_CMD] = np.clip(told, -self._limit, self._limit)
        return 0
