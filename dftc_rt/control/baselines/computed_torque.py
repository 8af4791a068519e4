"""B0: computed torque with the feedback gains of the ``dftc`` law and no fault tolerance."""

from __future__ import annotations

from collections.abc import Mapping

from dftc_rt.control.baselines.base import AddFriction, Baseline, InverseDynamics
from dftc_rt.control.interface import F64, NONFINITE_INPUT
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.control.signals import AD, VD, Q, S, V


class ComputedTorque(Baseline):
    """u = RNEA(q, v, q̈_d - (λ + k) ė - k λ e) + friction: (10) without δ̂, ξ̂, with the full model.

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
        super().__init__(joints, gains, add_friction)
        self._inverse_dynamics = inverse_dynamics

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle, see :class:`dftc_rt.control.interface.Law`."""
        if not self._begin(rec):
            return NONFINITE_INPUT
        acceleration = rec[AD] - self._lam * (rec[V] - rec[VD]) - self._k * rec[S]
        u = self._inverse_dynamics(rec[Q], rec[V], acceleration)
        if self._add_friction is not None:
            self._add_friction(u, rec[VD])
        return self._send(rec, u, u)
