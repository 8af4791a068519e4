"""The whole closed loop as one ordinary differential equation, in a stiff solver.

Plant, controller weights, δ̂, ξ̂, identifier and every observer of
:data:`dftc_rt.paper.observers.READINGS` are one state. The right-hand side is put together
from :mod:`dftc_rt.control.rates`, the same functions that the discrete law steps, with the
parameters of the law ``paper``; sgn is tanh(s/ε), ĝ is kept above :data:`G_MIN`. The solver is
started anew where the fault begins.

Source: [zhao2017] eq. (1)-(33).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from dftc_rt.config.scenario import ReferenceTable
from dftc_rt.control import layout, settings
from dftc_rt.dynamics.closed_form.plants import CLOSED_FORMS, Compiled
from dftc_rt.errors import InputError
from dftc_rt.paper import observers
from dftc_rt.paper.examples import EXAMPLES, IDENTIFIER_STATE, Q0, Example
from dftc_rt.paper.observers import ObserverReading
from dftc_rt.paper.right_hand_side import (
    BASE,
    HELD,
    NO_GAIN,
    ON,
    PER_OBSERVER,
    QD,
    REMOVED,
    RHO,
    SIGNALS,
    TRUE_GAIN,
    W_F,
    W_FO,
    W_G,
    W_GO,
    X1,
    X1F,
    X1FO,
    X1O,
    X2,
    X2F,
    X2FO,
    X2O,
    M,
    Mode,
    right_hand_side,
)
from dftc_rt.paper.variant import Variant
from dftc_rt.reference import Reference

F64 = NDArray[np.float64]

G_MIN: Final = 1e-3
"""Least ĝ of the controller: (10) divides by it, and as printed it may pass through zero."""
SAMPLE_S: Final = 1e-3
"""Spacing of a solution's samples, s."""

_ROBUST: Final = {"on": ON, "held": HELD, "removed": REMOVED}

_FORM = np.dtype(
    [(n, np.int64) for n in ("true_rho", "correction", "models", "normalised")]
    + [(n, np.float64) for n in ("gamma_rho", "l2f")],
    align=True,
)


@dataclass(frozen=True)
class Solution:
    """Samples of a closed loop, K in number.

    Attributes:
        example: The example.
        variant: What was simulated.
        t: (K,), s.
        q: Positions, (K, 2), rad.
        v: Velocities, (K, 2), rad/s.
        signals: (K, :data:`SIGNALS`, 2).
        rho_hat: ρ̂ of every observer, (K, observers, 2).
        rho: True ρ_1, (K,).
        end: State at the end, as the solver has it.
        evaluations: Evaluations of the right-hand side.
        failed: What the solver said if it gave up before the end; else None.
        observers: Names of the observers that ran along.
    """

    example: Example
    variant: Variant
    t: F64
    q: F64
    v: F64
    signals: F64
    rho_hat: F64
    rho: F64
    end: F64
    evaluations: int
    failed: str | None
    observers: tuple[str, ...] = observers.NAMES

    def error(self, joint: int) -> F64:
        """Tracking error q - q_d of a joint (0 or 1), (K,), rad."""
        e: F64 = self.q[:, joint] - self.signals[:, QD, joint]
        return e

    def estimate(self, name: str, joint: int = 0) -> F64:
        """ρ̂ of an observer that ran along, by name, (K,)."""
        rho: F64 = self.rho_hat[:, self.observers.index(name), joint]
        return rho

    def window(self, start_s: float, end_s: float = np.inf) -> NDArray[np.bool_]:
        """Samples from ``start_s`` to ``end_s``, s, as a mask (K,)."""
        mask: NDArray[np.bool_] = (self.t >= start_s) & (self.t <= end_s)
        return mask


class ClosedLoop:
    """The right-hand side of one variant, ready for a solver."""

    def __init__(
        self, variant: Variant, readings: Sequence[ObserverReading] = observers.READINGS
    ) -> None:
        """Build parameters and work arrays.

        Args:
            variant: What is to be simulated.
            readings: Observers that run along.

        Raises:
            InputError: A name or a gain of the variant is wrong.
        """
        self.variant = variant
        self.readings = readings
        self.example = EXAMPLES[variant.example]
        plant = variant.plant or self.example.plant
        if plant not in CLOSED_FORMS:
            raise InputError("plant", f"'{plant}'", "one of " + ", ".join(CLOSED_FORMS))
        self._rhs, self._jac = right_hand_side(plant)
        self._par = parameters(variant.epsilon, variant.gains)
        table = ReferenceTable(kind=self.example.reference, blend_s=0.0)
        reference = Reference(table, np.zeros(2))
        self._motion = variant.reading.motion or reference.harmonics
        self._forms = np.zeros(len(readings), dtype=_FORM)
        for form, reading in zip(self._forms, readings, strict=True):
            for name in ("true_rho", "correction", "models", "normalised"):
                form[name] = getattr(reading, name)
            for name in ("gamma_rho", "l2f"):
                value = getattr(reading, name)
                form[name] = self._par[name][0] if value is None else value
        fit = variant.fitted
        self._fit = (fit.centres, fit.inv_width, fit.w_f, fit.w_g, fit.interconnection)
        self._work = (
            np.zeros((14, 2)), np.zeros((6, 2)), np.zeros(M), np.zeros(fit.centres.shape[1]),
        )  # fmt: skip
        self.states = BASE + PER_OBSERVER * len(readings)
        self._dz = np.zeros((2, self.states))
        self._sig = np.zeros((SIGNALS, 2))
        self.evaluations = 0
        self.enter(False)

    def initial(self) -> F64:
        """State at t = 0, (2 states,)."""
        z = np.zeros((2, self.states))
        read = self.variant.reading
        z[:, X1] = read.q0
        z[:, X1O], z[:, X2O] = IDENTIFIER_STATE
        z[:, W_F] = z[:, W_G] = self.example.w_f
        z[:, W_FO], z[:, W_GO] = self.example.w_fo, self.example.w_go
        if read.weights_seed is not None:
            rng = np.random.default_rng(read.weights_seed)
            for block in (W_F, W_G, W_FO, W_GO):
                z[:, block] = rng.uniform(-0.5, 0.5, (2, M))
        for r, reading in enumerate(self.readings):
            at = BASE + PER_OBSERVER * r
            z[:, at + X1F], z[:, at + X2F] = IDENTIFIER_STATE
            start = IDENTIFIER_STATE if reading.correction else (Q0[0], 0.0)
            z[:, at + X1FO], z[:, at + X2FO] = start
            z[:, at + RHO] = read.rho0
        return z.ravel()

    def enter(self, faulty: bool) -> None:
        """Choose what follows: before the fault, or under it."""
        variant = self.variant
        fault = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        if faulty and variant.fault:
            fault[0] = self.example.rho
            if variant.reading.both:
                fault[1] = self.example.rho
        source = NO_GAIN
        if variant.gain == "true":
            source = TRUE_GAIN
        elif variant.gain != "none":
            source = [reading.name for reading in self.readings].index(variant.gain)
        read = variant.reading
        acts = [_ROBUST[name or variant.robust] for name in (read.delta, read.xi, read.networks)]
        delta, xi, networks = acts if faulty else (ON, ON, ON)
        mode = Mode(
            delta=delta, xi=xi, learns=networks == ON,
            trains=not faulty or variant.identifier == "adapt", source=source,
            known=read.known, error13=read.error13, applied12=read.applied12, sgn18=read.sgn18,
            delivered18=read.delivered18, limit=read.limit_nm,
        )  # fmt: skip
        self._phase = (
            self._par, self._motion, fault, mode, self._forms, self._fit, self._work,
        )  # fmt: skip

    def compiled(self) -> tuple[Compiled, tuple[Any, ...]]:
        """Right-hand side ``(t, z, dz, sig, *rest)`` and its ``rest``, for a compiled solver."""
        return self._rhs, self._phase

    def rates(self, t: float, z: F64) -> F64:
        """Right-hand side at time t, s, and state z (2 states,)."""
        self.evaluations += 1
        self._rhs(t, z.reshape(2, -1), self._dz, self._sig, *self._phase)
        return self._dz.ravel().copy()

    def jacobian(self, t: float, z: F64) -> F64:
        """∂rates/∂z, (2 states, 2 states)."""
        jac = np.empty((z.size, z.size))
        self._jac(t, z.reshape(2, -1).copy(), jac, self._sig, *self._phase)
        return jac

    def signals(self, t: float, z: F64) -> F64:
        """What is computed on the way, (SIGNALS, 2)."""
        self._rhs(t, z.reshape(2, -1), self._dz, self._sig, *self._phase)
        return self._sig.copy()


def parameters(epsilon: float, gains: dict[str, Any]) -> Any:
    """Parameters of the law ``paper`` for two joints, (2,) of ``layout.PARAMETERS``.

    Args:
        epsilon: Width of the boundary layers of (10) and (18), shape tanh, rad/s.
        gains: Other settings that differ from the printed ones.

    Raises:
        InputError: A setting is unknown or out of bounds.
    """
    smooth: dict[str, Any] = {
        "layer": epsilon,
        "layer_o": epsilon,
        "layer_shape": "tanh",
        "g_min": G_MIN,
    }
    parsed = settings.parse({**smooth, **gains}, 2, printed=True)
    endless = np.full(2, np.inf)
    joints = layout.Joints(
        1.0, endless, np.zeros(2), np.zeros(2, dtype=np.int64), -endless, endless, endless
    )
    return layout.allocate(parsed, joints, ftc=True).parameters


def solve(
    variant: Variant,
    rtol: float = 1e-6,
    atol: float = 1e-8,
    readings: Sequence[ObserverReading] = observers.READINGS,
) -> Solution:
    """Integrate a variant with SciPy's Radau and sample it.

    Args:
        variant: What is to be simulated.
        rtol: Relative tolerance.
        atol: Absolute tolerance.
        readings: Observers that run along; fewer take less time.

    Raises:
        InputError: A name or a gain of the variant is wrong.
    """
    loop = ClosedLoop(variant, readings)
    example = loop.example
    times = np.arange(round(example.duration_s / SAMPLE_S) + 1) * SAMPLE_S
    z = loop.initial()
    parts: list[tuple[F64, F64, F64]] = []
    failed = None
    for start, end, faulty in (
        (0.0, example.fault_s, False),
        (example.fault_s, example.duration_s, True),
    ):
        loop.enter(faulty)
        at = times[(times >= start - 1e-9) & (times <= end + 1e-9)]
        result = solve_ivp(
            loop.rates, (start, end), z, method="Radau", t_eval=at, jac=loop.jacobian,
            rtol=rtol, atol=atol,
        )  # fmt: skip
        states = result.y.T
        signals = np.empty((len(states), SIGNALS, 2))
        for k, (t_k, z_k) in enumerate(zip(result.t, states, strict=True)):
            signals[k] = loop.signals(t_k, z_k)
        parts.append((result.t, states, signals))
        if not result.success:
            failed = str(result.message)
            break
        z = states[-1]
        if not faulty:  # the first sample of what follows is the same instant
            parts[-1] = (result.t[:-1], states[:-1], signals[:-1])
    t, states, signals = (np.concatenate(column) for column in zip(*parts, strict=True))
    joints = states.reshape(len(t), 2, -1)
    heads = [BASE + PER_OBSERVER * r + RHO for r in range(len(readings))]
    return Solution(
        example, variant, t, joints[:, :, X1], joints[:, :, X2], signals,
        np.moveaxis(joints[:, :, heads], 1, 2), example.effectiveness(t) if variant.fault
        else np.ones(len(t)), states[-1], loop.evaluations, failed,
        tuple(reading.name for reading in readings),
    )  # fmt: skip
