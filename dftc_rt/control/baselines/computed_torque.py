"""B0: computed torque with the feedback gains of the ``dftc`` law and no fault tolerance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from dftc_rt.control import settings
from dftc_rt.control.interface import F64, NONFINITE_INPUT, NONFINITE_LAW
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

InverseDynamics = Callable[[F64, F64, F64], F64]
"""(q, v, a) in rad, rad/s, rad/s² to torque in Nm, (n,) each."""

AddFriction = Callable[[F64, F64], None]
"""(torque, v): adds the calibrated friction at v (n,), rad/s, to torque (n,), Nm."""


class ComputedTorque:
    """u = RNEA(q, v, q̈_d - (λ + k) ė - k λ e): the linear part of (10) with the full model.

    Attributes:
        ftc: Always False: there is no estimate that could act.
        uses_local_terms: False.
    """

    def __init__(
        self,
        joints: Joints,
        gains: Mapping[str, Value],
        inverse_dynamics: InverseDynamics,
        add_friction: AddFriction | None = None,
    ) -> None:
        """Allocate the law.

        Args:
            joints: Robot and drives.
            gains: Keys of :data:`dftc_rt.control.settings.NAMES`; ``lam`` and ``k`` are used.
            inverse_dynamics: Torque for a motion, whole robot.
            add_friction: Friction of a calibrated robot; None: none is assumed.

        Raises:
            InputError: A gain is unknown or out of bounds.
        """
        n = joints.torque_limit.shape[0]
        parsed = settings.parse(gains, n, printed=False)
        self.ftc = False
        self.uses_local_terms = False
        self._lam: F64 = parsed.values["lam"]
        self._k: F64 = parsed.values["k"]
        self._limit = joints.torque_limit
        stepped = joints.torque_resolution > 0.0
        self._resolution = np.where(stepped, joints.torque_resolution, 1.0)
        self._stepped = stepped
        self._counts = np.floor(joints.torque_limit / self._resolution + 1e-9)
        self._inverse_dynamics = inverse_dynamics
        self._add_friction = add_friction

    def start(self, q: F64, v: F64) -> None:
        """Check the shapes; the law has no state.

        Raises:
            InputError: A shape is wrong or a value is not finite.
        """
        n = self._limit.shape[0]
        for name, values in (("q", q), ("v", v)):
            if np.shape(values) != (n,) or not np.all(np.isfinite(values)):
                raise InputError(f"start {name}", str(values), f"{n} finite values")

    def skip(self, ticks: int) -> None:
        """Nothing to account for: the law has no memory."""

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle, see :class:`dftc_rt.control.interface.Law`."""
        rec[RHO_HAT] = math.nan
        rec[RHO_STD] = math.nan
        rec[OBSERVABLE] = 0.0
        rec[VERDICT] = NOT_OBSERVABLE
        rec[RESIDUAL] = math.nan
        rec[TAU_LAW] = 0.0
        rec[TAU_CMD] = 0.0
        if not np.isfinite(rec[: AD + 1]).all():
            rec[S] = math.nan
            return NONFINITE_INPUT
        e1 = rec[Q] - rec[QD]
        e2 = rec[V] - rec[VD]
        rec[S] = self._lam * e1 + e2
        acceleration = rec[AD] - self._lam * e2 - self._k * rec[S]
        u = self._inverse_dynamics(rec[Q], rec[V], acceleration)
        if self._add_friction is not None:
            self._add_friction(u, rec[VD])
        if not np.isfinite(u).all():
            return NONFINITE_LAW
        rec[TAU_LAW] = u
        rounded = np.clip(np.floor(u / self._resolution + 0.5), -self._counts, self._counts)
        told = np.where(self._stepped, rounded * self._resolution, u)
        rec[TAU_CMD] = np.clip(told, -self._limit, self._limit)
        return 0
