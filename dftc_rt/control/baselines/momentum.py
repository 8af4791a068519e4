"""B1: generalised-momentum observer and regression of ρ, with the model of the whole robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numba import njit

from dftc_rt.control import decision, gain, observer
from dftc_rt.control.baselines.base import AddFriction, Baseline, InverseDynamics, Matrices
from dftc_rt.control.interface import F64, NONFINITE_INPUT, NONFINITE_LAW
from dftc_rt.control.kernel import drive_torque
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    AD,
    AGE,
    ANOMALY,
    HEALTHY,
    NOT_OBSERVABLE,
    OBSERVABLE,
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

_CACHE = {"cache": True, "fastmath": False}
_MOST_TICKS = 100_000

_FLOATS = (
    "applied", "drive_sum",  # torque of a healthy drive: at the last SYNC, summed since a sample
    "v_last", "p_last", "need_last",  # last sample: rad/s, kg m²/s, Nm
    "r", "u_f", "gap_f",  # observer, filtered torque, q̈ - q̈_d
    "square", "product",  # S, X over their memory, Nm²
    "rho", "variance", "loss", "excess", "clear_for", "verdict", "gain",
)  # fmt: skip
STATE = np.dtype(
    [(name, np.float64) for name in _FLOATS]
    + [(name, np.int64) for name in ("cycle", "elapsed", "primed")],
    align=True,
)


@njit(**_CACHE)
def observe(
    p: Any, x: Any, v: float, acc_d: float, momentum: float, need: float, inertia: float
) -> bool:
    """Step observer and regression with a fresh sample, and feed the CUSUMs.

    Args:
        p: Parameters.
        x: State; ``drive_sum`` and ``elapsed`` cover the interval since the last sample.
        v: Velocity, rad/s.
        acc_d: q̈_d, rad/s².
        momentum: p_i = (M q̇)_i, kg m²/s.
        need: (G - Cᵀ q̇)_i + τ̂_fric, Nm.
        inertia: M_ii, kg m².

    Returns:
        Whether ρ can be observed.

    Source: [deluca2003]; regression and test are ours.
    """
    h = p.period
    span = h * x.elapsed
    torque = x.drive_sum / x.elapsed
    missing = (momentum - x.p_last) / span + 0.5 * (need + x.need_last) - torque
    share = 1.0 - math.exp(-p.momentum_bandwidth * span)
    x.r += share * (missing - x.r)
    x.u_f += share * (torque - x.u_f)
    x.gap_f += share * ((v - x.v_last) / span - acc_d - x.gap_f)
    x.v_last, x.p_last, x.need_last = v, momentum, need
    x.drive_sum = 0.0
    x.elapsed = 0
    if x.cycle < p.warmup:
        return False
    kept = math.exp(-span / p.momentum_memory_s)
    x.square = kept * x.square + (1.0 - kept) * x.u_f * x.u_f
    x.product = kept * x.product + (1.0 - kept) * x.r * x.u_f
    least = p.excitation * p.floor
    if x.square < least * least:
        return False
    x.rho = min(max(1.0 + x.product / x.square, 0.0), observer.RHO_TOP)
    noise = p.velocity_noise * p.momentum_bandwidth
    one = p.inflation * observer.residual_variance(
        p.floor, noise, inertia, acc_d, x.gap_f, need, v,
        p.sigma_acc, p.sigma_transient, p.sigma_bias, p.sigma_friction * p.limit, p.v_friction,
    )  # fmt: skip
    x.variance = one * (1.0 - kept) / ((1.0 + kept) * x.square)
    y = x.u_f + x.r
    below = decision.log_likelihood_ratio(x.u_f, y, 1.0 - p.rho_step, one)
    above = decision.log_likelihood_ratio(x.u_f, y, 1.0 + p.rho_step, one)
    top = 1.5 * max(p.threshold_loss, p.threshold_anomaly)
    x.loss = decision.cusum(x.loss, below, top)
    x.excess = decision.cusum(x.excess, above, top)
    x.clear_for = decision.clearing(x.clear_for, x.rho, p.rho_clear, span)
    return True


@njit(**_CACHE)
def decide(p: Any, x: Any, observable: bool) -> None:
    """Verdict: a CUSUM over its threshold; a loss is latched until ρ̂ has stayed near 1."""
    if x.verdict == ACTUATOR_LOSS:
        if x.clear_for < p.clear_s:
            return
        x.loss = 0.0
        x.excess = 0.0
    if x.loss >= p.threshold_loss and x.rho < p.rho_loss:
        x.verdict = ACTUATOR_LOSS
        x.clear_for = 0.0
    elif max(x.loss, x.excess) >= p.threshold_anomaly:
        x.verdict = ANOMALY
    else:
        x.verdict = HEALTHY if observable else NOT_OBSERVABLE


@njit(**_CACHE)
def joint(
    i: int, rec: F64, fresh: bool, u: float, momentum: float, need: float, inertia: float,
    p: Any, x: Any, history: F64,
) -> int:  # fmt: skip
    """One cycle of joint i; ``u`` is the torque of the law, Nm, NaN to be silent."""
    slot = x.cycle % history.shape[0]
    x.drive_sum += drive_torque(p, x, history)
    x.elapsed += 1
    history[slot] = 0.0
    bad = not math.isfinite(u + momentum + need + inertia)
    observable = False
    if fresh and not bad:
        if x.primed:
            observable = observe(p, x, rec[V, i], rec[AD, i], momentum, need, inertia)
        else:
            x.v_last, x.p_last, x.need_last = rec[V, i], momentum, need
            x.drive_sum = 0.0
            x.elapsed = 0
            x.primed = 1
    x.cycle += 1
    decide(p, x, observable)
    rec[RHO_HAT, i] = x.rho
    rec[RHO_STD, i] = math.sqrt(x.variance) if observable else math.nan
    rec[OBSERVABLE, i] = 1.0 if observable else 0.0
    rec[VERDICT, i] = x.verdict
    rec[RESIDUAL, i] = x.r
    if bad:
        return NONFINITE_LAW
    wanted = 1.0
    if p.ftc == 1 and (p.momentum_gate == gain.ALWAYS or x.verdict == ACTUATOR_LOSS):
        wanted = gain.target(x.rho, p.rho_min, p.rho_max)
    x.gain = gain.follow(x.gain, wanted, p.gain_rate, p.period)
    told = gain.command(u, x.gain, p.counts, p.resolution, p.limit)
    history[slot] = told
    rec[TAU_LAW, i] = u
    rec[TAU_CMD, i] = told
    return 0


@njit(**_CACHE)
def skip(par: Any, st: Any, history: F64, ticks: int) -> None:
    """Account for ``ticks`` periods in which the torque in force stayed."""
    for i in range(par.shape[0]):
        for _ in range(ticks):
            st[i].drive_sum += drive_torque(par[i], st[i], history[i])
            st[i].elapsed += 1


@njit(**_CACHE)
def cycle(
    rec: F64, fresh: bool, u: F64, momentum: F64, need: F64, inertia: F64,
    par: Any, st: Any, history: F64,
) -> int:  # fmt: skip
    """Kernel over all joints; returns the or of their status bits."""
    status = 0
    for i in range(par.shape[0]):
        status |= joint(
            i, rec, fresh, u[i], momentum[i], need[i], inertia[i], par[i], st[i], history[i]
        )
    return status


CYCLE: Callable[..., int] = cycle


class Momentum(Baseline):
    """u = u0/ρ̂ with ρ̂ from r = (ρ - 1) u_f of the momentum observer.

    u0 = RNEA(q, q̇, q̈_d) - M_ii ((λ + k) ė + k λ e) + friction: the feedback torque of one joint
    is that of the law ``dftc``. (Through the whole M, as in computed torque, a mode in which two
    axes nearly align would have little inertia and so little stiffness against friction.)

    p = M q̇;  r = K [p - p(0) - ∫ (u + Cᵀ q̇ - G - τ̂_fric + r) dt];  u̇_f = K (u - u_f)
    S, X: means of u_f², r u_f over ``momentum_memory_s``;  ρ̂ = 1 + X/S in [0, 1.2],
    held while √S is under the excitation floor. K = ``momentum_bandwidth``.

    The decision is that of two CUSUMs of y = u_f + r on φ = u_f with the settings of the law
    ``dftc``. The gain 1/ρ̂ acts always, or after an actuator loss was decided (``momentum_gate``).

    Attributes:
        ftc: Whether the gain is applied.
        state: (n,) of :data:`STATE`.

    Source: [deluca2003], [page1954].
    """

    def __init__(
        self,
        joints: Joints,
        gains: Mapping[str, Value],
        inverse_dynamics: InverseDynamics,
        matrices: Matrices,
        add_friction: AddFriction | None = None,
        *,
        ftc: bool,
    ) -> None:
        """Allocate the law.

        Args:
            joints: Robot and drives.
            gains: Keys of :data:`dftc_rt.control.settings.NAMES`.
            inverse_dynamics: Torque for a motion, whole robot.
            matrices: M, C and G of the same robot.
            add_friction: Friction of a calibrated robot; None: none is assumed.
            ftc: Whether the gain is applied.

        Raises:
            InputError: A gain is unknown or out of bounds.
        """
        super().__init__(joints, gains, add_friction, ftc=ftc)
        self._inverse_dynamics = inverse_dynamics
        self._matrices = matrices
        self.state = np.zeros(joints.torque_limit.shape[0], dtype=STATE)
        self._silent = np.full(joints.torque_limit.shape[0], math.nan)
        self._cycle = CYCLE

    def start(self, q: F64, v: F64) -> None:
        """Reset every state.

        Raises:
            InputError: A shape is wrong or a value is not finite.
        """
        super().start(q, v)
        state = self.state
        state[:] = 0
        state["rho"] = 1.0
        state["gain"] = 1.0
        state["verdict"] = NOT_OBSERVABLE

    def skip(self, ticks: int) -> None:
        """Ticks without a cycle, see :class:`dftc_rt.control.interface.Law`."""
        skip(self.parameters, self.state, self.history, min(ticks, _MOST_TICKS))

    def told(self, joint: int, tau: float) -> None:
        """Another command was sent, see :class:`dftc_rt.control.interface.Law`."""
        last = int(self.state["cycle"][joint]) - 1
        self.history[joint, last % self.history.shape[1]] = tau

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle, see :class:`dftc_rt.control.interface.Law`."""
        if not self._begin(rec):
            none = self._silent
            self._step(rec, False, none, none, none, none)
            return NONFINITE_INPUT
        q, v = rec[Q], rec[V]
        mass = self._matrices.mass_matrix(q)
        own = np.diagonal(mass).copy()
        need = self._matrices.gravity(q) - self._matrices.coriolis_matrix(q, v).T @ v
        u = self._inverse_dynamics(q, v, rec[AD])
        u = u - own * (self._lam * (v - rec[VD]) + self._k * rec[S])
        if self._add_friction is not None:
            self._add_friction(need, rec[VD])
            self._add_friction(u, rec[VD])
        fresh = not rec[AGE].any()  # p and Cᵀ q̇ take the state of all joints at one instant
        return self._step(rec, fresh, u, mass @ v, need, own)

    def _step(self, rec: F64, fresh: bool, u: F64, momentum: F64, need: F64, inertia: F64) -> int:
        return self._cycle(
            rec, fresh, u, momentum, need, inertia, self.parameters, self.state, self.history
        )
