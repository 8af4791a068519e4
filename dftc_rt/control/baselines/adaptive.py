"""B3: direct adaptation of θ = 1/ρ with the model of the whole robot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dftc_rt.control.baselines.base import AddFriction, Baseline, Matrices
from dftc_rt.control.interface import F64, NONFINITE_INPUT
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    AD,
    HEALTHY,
    NOT_OBSERVABLE,
    OBSERVABLE,
    QD,
    RHO_HAT,
    VD,
    VERDICT,
    Q,
    S,
    V,
)

Mask = NDArray[np.bool_]


class Adaptive(Baseline):
    """u = θ̂ u0 with u0 = M q̈_r + C q̇_r + G - K_d s and θ̂̇ = Proj(-γ s u0), on [1, 1/ρ_min].

    q̇_r = q̇_d - λ e, K_d = M_ii k. With V = ½ sᵀM s + Σ ρ (θ̂ - 1/ρ)²/(2 γ) and a constant ρ,
    V̇ = -sᵀ K_d s: it needs Ṁ = C + Cᵀ. γ_i = ``gamma_theta`` M_ii/u_max² with M_ii of the pose
    at the start is constant; the loop of s and θ̂ then has ω² = ``gamma_theta`` ρ (u0/u_max)².

    There is no test for a fault: the verdict is a loss from ρ̂ < ``rho_loss`` on, until ρ̂ has
    stayed at ``rho_clear`` or above for ``clear_s``. Where |u0| is under the excitation floor, ρ
    counts as not observable; θ̂ stays by itself there.

    Attributes:
        ftc: Whether θ̂ is applied. Without it s is no measure of θ̂'s error, and there is no
            estimate.
        theta: θ̂, (n,).

    Source: [slotine1987] for the law; the adaptation of the input gain is the same argument.
    """

    def __init__(
        self,
        joints: Joints,
        gains: Mapping[str, Value],
        matrices: Matrices,
        add_friction: AddFriction | None = None,
        *,
        ftc: bool,
    ) -> None:
        """Allocate the law.

        Args:
            joints: Robot and drives.
            gains: Keys of :data:`dftc_rt.control.settings.NAMES`.
            matrices: M, C and G of the whole robot.
            add_friction: Friction of a calibrated robot; None: none is assumed.
            ftc: Whether θ̂ is applied, and adapted.

        Raises:
            InputError: A gain is unknown or out of bounds.
        """
        super().__init__(joints, gains, add_friction, ftc=ftc)
        par = self.parameters
        self._matrices = matrices
        self._period = joints.period_s
        self._top: F64 = 1.0 / par["rho_min"]
        self._dead_zone: F64 = par["dead_zone_theta"].copy()
        self._freeze: Mask = par["freeze_saturated"] == 1
        self._least: F64 = par["excitation"] * par["floor"]
        self._warmup: F64 = par["warmup"].copy()
        self._rho_loss: F64 = par["rho_loss"].copy()
        self._rho_clear: F64 = par["rho_clear"].copy()
        self._clear_s: F64 = par["clear_s"].copy()
        n = joints.torque_limit.shape[0]
        self._gamma = np.zeros(n)
        self.theta = np.ones(n)
        self._lost: Mask = np.zeros(n, dtype=np.bool_)
        self._clear_for = np.zeros(n)
        self._cycle = 0

    def start(self, q: F64, v: F64) -> None:
        """Reset θ̂ and fix γ at this pose.

        Raises:
            InputError: A shape is wrong or a value is not finite.
        """
        super().start(q, v)
        own = np.diag(self._matrices.mass_matrix(np.array(q, dtype=np.float64)))
        self._gamma[:] = self.parameters["gamma_theta"] * own / self._limit**2
        self.theta[:] = 1.0
        self._lost[:] = False
        self._clear_for[:] = 0.0
        self._cycle = 0

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle, see :class:`dftc_rt.control.interface.Law`."""
        self._cycle += 1
        if not self._begin(rec):
            return NONFINITE_INPUT
        q, v, s, vd = rec[Q], rec[V], rec[S], rec[VD]
        vr = vd - self._lam * (q - rec[QD])
        ar = rec[AD] - self._lam * (v - vd)
        mass = self._matrices.mass_matrix(q)
        u0 = mass @ ar + self._matrices.coriolis_matrix(q, v) @ vr + self._matrices.gravity(q)
        u0 -= self._k * np.diagonal(mass) * s
        if self._add_friction is not None:
            self._add_friction(u0, vd)
        if not self.ftc:
            return self._send(rec, u0, u0)
        wanted = self.theta * u0
        status = self._send(rec, u0, wanted)
        if status == 0:
            self._adapt(s, u0, np.abs(wanted) > self._limit)
        rho = 1.0 / self.theta
        observable = np.abs(u0) >= self._least
        self._decide(rho)
        rec[RHO_HAT] = rho
        rec[OBSERVABLE] = observable
        rec[VERDICT] = np.where(
            self._lost, ACTUATOR_LOSS, np.where(observable, HEALTHY, NOT_OBSERVABLE)
        )
        return status

    def _adapt(self, s: F64, u0: F64, saturated: Mask) -> None:
        """One explicit step of θ̂̇ = Proj(-γ s u0)."""
        size = np.maximum(np.abs(s) - self._dead_zone, 0.0)
        step = -self._period * self._gamma * np.copysign(size, s) * u0
        step[(saturated & self._freeze) | (self._cycle <= self._warmup)] = 0.0
        np.clip(self.theta + step, 1.0, self._top, out=self.theta)

    def _decide(self, rho: F64) -> None:
        """Latch a loss; release it after ``clear_s`` near 1."""
        self._clear_for += self._period
        self._clear_for[rho < self._rho_clear] = 0.0
        self._lost |= rho < self._rho_loss
        self._lost &= self._clear_for < self._clear_s
