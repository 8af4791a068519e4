"""B2: a linear extended-state observer per joint, which cancels whatever disturbs it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numba import njit

from dftc_rt.control import gain
from dftc_rt.control.baselines.base import AddFriction, Baseline
from dftc_rt.control.interface import F64, NONFINITE_INPUT, NONFINITE_LAW
from dftc_rt.control.kernel import drive_torque
from dftc_rt.control.layout import Joints
from dftc_rt.control.settings import Value
from dftc_rt.control.signals import AD, AGE, QD, RESIDUAL, TAU_CMD, TAU_LAW, VD, Q, V

_CACHE = {"cache": True, "fastmath": False}
_SPLIT = 1
_MEASURED = 1
_MOST_TICKS = 100_000

STATE = np.dtype(
    [(name, np.float64) for name in ("z1", "z2", "z3", "applied", "inertia", "known")]
    + [("cycle", np.int64)],
    align=True,
)


def gains(omega: F64, period_s: float) -> F64:
    """Observer gains (3, n) that put the three poles of every joint at exp(-ω h).

    Those of (1 - z⁻¹ e^{-ωh})³ for a triple integrator whose correction uses the newest sample;
    for a short period they tend to h (3ω, 3ω², ω³).

    Args:
        omega: ω, (n,), rad/s.
        period_s: h, s.

    Returns:
        Corrections of z1, z2, z3 per error: 1, 1/s, 1/s².

    Source: [gao2003] for one pole for all; the discrete gains follow from the same demand.
    """
    pole = np.exp(-omega * period_s)
    lost = 1.0 - pole
    corrections: F64 = np.stack(
        [1.0 - pole**3, 1.5 * lost**2 * (1.0 + pole) / period_s, lost**3 / period_s**2]
    )
    return corrections


@njit(**_CACHE)
def predict(x: Any, torque: float, inertia: float, known: float, h: float) -> None:
    """Move z over one period in which M q̈ = torque - known + M z3, all held.

    Args:
        x: State of the joint.
        torque: Mean torque of a healthy drive over the period, Nm.
        inertia: M_i, kg m².
        known: Torque that the model asks for besides M_i q̈_i, Nm.
        h: Period, s.
    """
    acceleration = (torque - known) / inertia + x.z3
    x.z1 += h * (x.z2 + 0.5 * h * acceleration)
    x.z2 += h * acceleration


@njit(**_CACHE)
def joint(
    i: int, rec: F64, m: float, w: float, ok: bool, act: bool, p: Any, x: Any, g: F64, history: F64
) -> int:
    """One cycle of joint i; returns status bits."""
    h = p.period
    torque = drive_torque(p, x, history)
    slot = x.cycle % history.shape[0]
    history[slot] = 0.0
    if x.cycle > 0:
        middle = ok and x.inertia > 0.0
        inertia = 0.5 * (m + x.inertia) if middle else x.inertia
        if inertia > 0.0:
            predict(x, torque, inertia, 0.5 * (w + x.known) if middle else x.known, h)
    x.cycle += 1
    if not ok:
        return NONFINITE_INPUT
    x.inertia, x.known = m, w
    q = rec[Q, i]
    if rec[AGE, i] == 0.0:
        error = q - x.z1
        x.z1 += g[0] * error
        x.z2 += g[1] * error
        x.z3 += g[2] * error
    e1 = q - rec[QD, i]
    e2 = (rec[V, i] if p.eso_velocity == _MEASURED else x.z2) - rec[VD, i]
    wanted = rec[AD, i] - (p.lam + p.k) * e2 - p.k * p.lam * e1
    u = w + m * (wanted - (x.z3 if act else 0.0))
    if not math.isfinite(u):
        return NONFINITE_LAW
    told = gain.command(u, 1.0, p.counts, p.resolution, p.limit)
    history[slot] = told
    rec[TAU_LAW, i] = u
    rec[TAU_CMD, i] = told
    rec[RESIDUAL, i] = m * x.z3
    return 0


@njit(**_CACHE)
def skip(par: Any, st: Any, history: F64, ticks: int) -> None:
    """Let ``ticks`` periods pass in which the torque in force stays, without a measurement."""
    for i in range(par.shape[0]):
        p, x = par[i], st[i]
        for _ in range(ticks):
            torque = drive_torque(p, x, history[i])
            if x.cycle > 0 and x.inertia > 0.0:
                predict(x, torque, x.inertia, x.known, p.period)


@njit(**_CACHE)
def cycle(
    rec: F64, m: F64, w: F64, ok: bool, act: bool, par: Any, st: Any, g: F64, history: F64
) -> int:
    """Kernel over all joints; returns the or of their status bits."""
    status = 0
    for i in range(par.shape[0]):
        status |= joint(i, rec, m[i], w[i], ok, act, par[i], st[i], g[:, i], history[i])
    return status


CYCLE: Callable[..., int] = cycle


class Eso(Baseline):
    """u = w + M_i (q̈_d - (λ + k)(q̇ - q̇_d) - k λ (q - q_d) - z3), local to each joint.

    ε = q - z1;  ż1 = z2 + 3ω ε;  ż2 = (u - w)/M_i + z3 + 3ω² ε;  ż3 = ω³ ε, with ω = ``eso_ratio``
    √(k λ). The velocity fed back is the measured one, or z2 (``eso_velocity``). w is the torque
    that is known besides M_i q̈_i: the local terms (``eso_model = "split"``), or the calibrated
    friction alone (``"none"``). M_i z3, the torque missing against that model, is logged as the
    residual. There is no ρ̂.

    Attributes:
        ftc: False: z3 is estimated and logged, and not subtracted.
        state: (n,) of :data:`STATE`.

    Source: [han2009], in the linear form of [gao2003].
    """

    def __init__(
        self,
        joints: Joints,
        gains_: Mapping[str, Value],
        add_friction: AddFriction | None = None,
        *,
        ftc: bool,
    ) -> None:
        """Allocate the law.

        Args:
            joints: Robot and drives.
            gains_: Keys of :data:`dftc_rt.control.settings.NAMES`.
            add_friction: Friction of a calibrated robot; None: none is assumed.
            ftc: Whether z3 acts.

        Raises:
            InputError: A gain is unknown or out of bounds.
        """
        super().__init__(joints, gains_, add_friction, ftc=ftc, uses_local_terms=True)
        par = self.parameters
        n = par.shape[0]
        omega = par["eso_ratio"] * np.sqrt(par["k"] * par["lam"])
        self.state = np.zeros(n, dtype=STATE)
        self._gains = gains(omega, joints.period_s)
        self._split = par["eso_model"] == _SPLIT
        self._known = np.zeros(n)
        self._cycle = CYCLE

    def start(self, q: F64, v: F64) -> None:
        """Reset every state.

        Raises:
            InputError: A shape is wrong or a value is not finite.
        """
        super().start(q, v)
        self.state[:] = 0
        self.state["z1"] = q
        self.state["z2"] = v

    def skip(self, ticks: int) -> None:
        """Ticks without a cycle, see :class:`dftc_rt.control.interface.Law`."""
        skip(self.parameters, self.state, self.history, min(ticks, _MOST_TICKS))

    def told(self, joint: int, tau: float) -> None:
        """Another command was sent, see :class:`dftc_rt.control.interface.Law`."""
        last = int(self.state["cycle"][joint]) - 1
        self.history[joint, last % self.history.shape[1]] = tau

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """One cycle, see :class:`dftc_rt.control.interface.Law`; real-time safe."""
        known = self._known
        known.fill(0.0)
        ok = self._begin(rec)
        if ok and self._add_friction is not None:
            self._add_friction(known, rec[VD])
        np.copyto(known, bias, where=self._split)
        ok = bool(ok and np.isfinite(known).all() and np.isfinite(inertia).all())
        ok = bool(ok and (inertia > 0.0).all())
        return self._cycle(
            rec, inertia, known, ok, self.ftc, self.parameters, self.state, self._gains,
            self.history,
        )  # fmt: skip
