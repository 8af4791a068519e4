"""PD control with gravity compensation: the least that moves a robot along a reference."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dftc_rt.control import derate
from dftc_rt.control.baselines.base import AddFriction, Baseline, InverseDynamics
from dftc_rt.control.interface import F64, NONFINITE_INPUT
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.control.signals import QD, VD, Q, V


class PdGravity(Baseline):
    """u = G(q) - K_p e - K_d ė + friction, K_p = M_ii k λ and K_d = M_ii (λ + k) constant.

    M_ii is that of the pose at the start, so that the error of one joint decays there as under
    the other laws, ë + (λ + k) ė + k λ e = 0. There is no feed-forward of the acceleration.

    Source: [takegaki1981]; the choice of the gains is ours.
    """

    def __init__(
        self,
        joints: Joints,
        gains: Mapping[str, Value],
        inverse_dynamics: InverseDynamics,
        add_friction: AddFriction | None = None,
    ) -> None:
        """Allocate the law; arguments as of :class:`ComputedTorque`.

        Raises:
            InputError: A gain is unknown or out of bounds.
        """
        super().__init__(joints, gains, add_friction)
        self._inverse_dynamics = inverse_dynamics
        self._still = np.zeros(self._limit.shape[0])
        self._kp = np.zeros_like(self._still)
        self._kd = np.zeros_like(self._still)

    def start(self, q: F64, v: F64) -> None:
        """Fix the gains at this pose.

        Raises:
            InputError: A shape is wrong or a value is not finite.
        """
        super().start(q, v)
        own = np.diag(derate.mass_matrix(self._inverse_dynamics, np.array(q, dtype=np.float64)))
        self._kp[:] = own * self._k * self._lam
        self._kd[:] = own * (self._k + self._lam)

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle, see :class:`dftc_rt.control.interface.Law`."""
        if not self._begin(rec):
            return NONFINITE_INPUT
        u = self._inverse_dynamics(rec[Q], self._still, self._still)
        u = u - self._kp * (rec[Q] - rec[QD]) - self._kd * (rec[V] - rec[VD])
        if self._add_friction is not None:
            self._add_friction(u, rec[VD])
        return self._send(rec, u, u)
