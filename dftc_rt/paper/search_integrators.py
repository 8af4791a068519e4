"""Integrators for :mod:`dftc_rt.paper.search`: stiff, fixed step, and MATLAB's default.

Each takes a :class:`~dftc_rt.paper.closed_loop.ClosedLoop` from one time to another and
samples the positions of both joints and ρ̂_1 of its observers.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import Radau

from dftc_rt.dynamics.closed_form.plants import Compiled
from dftc_rt.paper.closed_loop import ClosedLoop
from dftc_rt.paper.right_hand_side import BASE, PER_OBSERVER, RHO, SIGNALS, X1

F64 = NDArray[np.float64]

ESCAPED_RAD: Final = 100.0
"""A joint this far away has left."""
SAMPLE_S: Final = 2e-3
"""Spacing of the samples, s; a larger fixed step samples at its own."""

_DONE, _ESCAPED, _GAVE_UP = 0, 1, 2
_STATUS: Final = ("done", "escaped", "gave up")


class _OverBudgetError(Exception):
    """The right-hand side was evaluated too often."""


@dataclass(frozen=True)
class Integrator:
    """How a reading is integrated.

    Attributes:
        kind: ``radau``, ``euler``, ``rk4`` or ``ode45``.
        step_s: Step of ``euler`` and ``rk4``, s.
        evaluations: After so many evaluations of the right-hand side it gives up; those for
            a Jacobian are not counted.
    """

    kind: str = "radau"
    step_s: float = 0.0
    evaluations: int = 40_000

    def __str__(self) -> str:
        if self.kind in ("euler", "rk4"):
            return f"{self.kind.capitalize() if self.kind == 'euler' else 'RK4'} {self.step_s:g} s"
        return {"radau": "Radau", "ode45": "RK45 1e-3/1e-6"}[self.kind]


@dataclass(frozen=True)
class Stretch:
    """Samples of a stretch of a run, K in number.

    Attributes:
        t: (K,), s.
        q: Positions, (K, 2), rad.
        rho_hat: ρ̂_1 of each observer, (K, observers).
        end: State at the end, (2 states,).
        status: ``done``; ``escaped`` (a joint beyond :data:`ESCAPED_RAD`, or not finite); or
            ``gave up`` (too many evaluations, or no step is small enough).
    """

    t: F64
    q: F64
    rho_hat: F64
    end: F64
    status: str


def integrate(loop: ClosedLoop, how: Integrator, start_s: float, end_s: float, z: F64) -> Stretch:
    """Take a loop from one time to another.

    Args:
        loop: The loop, its phase entered.
        how: The integrator.
        start_s: Beginning, s.
        end_s: End, s.
        z: State at the beginning, (2 states,).
    """
    picked = _picked(loop)
    if how.kind == "radau":
        return _radau(loop, how, start_s, end_s, z, picked)
    try:
        return _explicit(loop, how, start_s, end_s, z, picked)
    except ZeroDivisionError:  # ĝ = 0: (10) has no value
        return _stretch(np.array([start_s]), z[picked][None], z, _ESCAPED)


def _explicit(
    loop: ClosedLoop,
    how: Integrator,
    start_s: float,
    end_s: float,
    z: F64,
    picked: NDArray[np.int64],
) -> Stretch:
    """One of the compiled integrators."""
    rhs, rest = loop.compiled()
    fixed, adaptive = _kernels(rhs)
    state = z.reshape(2, -1).copy()
    if how.kind == "ode45":
        spacing = SAMPLE_S
        rows = np.empty((round((end_s - start_s) / spacing) + 1, len(picked)))
        code, count = adaptive(
            start_s, end_s, spacing, how.evaluations, state, rows, picked,
            np.zeros((SIGNALS, 2)), *rest,
        )  # fmt: skip
    else:
        every = max(round(SAMPLE_S / how.step_s), 1)
        spacing = every * how.step_s
        steps = round((end_s - start_s) / how.step_s)
        rows = np.empty((steps // every + 1, len(picked)))
        code, count = fixed(
            start_s, how.step_s, steps, every, how.kind == "rk4", state, rows, picked,
            np.zeros((SIGNALS, 2)), *rest,
        )  # fmt: skip
    return _stretch(start_s + spacing * np.arange(count), rows[:count], state.ravel(), code)


def _picked(loop: ClosedLoop) -> NDArray[np.int64]:
    """Places in the flat state of what is sampled: q_1, q_2, ρ̂_1 of each observer."""
    heads = [BASE + PER_OBSERVER * r + RHO for r in range(len(loop.readings))]
    return np.array([X1, loop.states + X1, *heads], dtype=np.int64)


def _stretch(t: F64, rows: F64, end: F64, code: int) -> Stretch:
    return Stretch(t, rows[:, :2].copy(), rows[:, 2:].copy(), end, _STATUS[code])


def _radau(
    loop: ClosedLoop,
    how: Integrator,
    start_s: float,
    end_s: float,
    z: F64,
    picked: NDArray[np.int64],
) -> Stretch:
    """SciPy's Radau, step by step, so that it can be stopped."""
    count = round((end_s - start_s) / SAMPLE_S) + 1
    times: F64 = np.linspace(start_s, start_s + SAMPLE_S * (count - 1), count)
    rows = [z[picked][None, :]]
    code, filled = _DONE, 1
    loop.evaluations = 0

    def rates(t: float, state: F64) -> F64:
        """Rates within the budget; with a state that is not finite a step never ends."""
        dz = loop.rates(t, state)
        if loop.evaluations > how.evaluations:
            raise _OverBudgetError
        if not math.isfinite(dz.sum()):
            raise FloatingPointError
        return dz

    solver = Radau(rates, start_s, z, end_s, jac=loop.jacobian, rtol=1e-5, atol=1e-7)
    while solver.status == "running":
        try:
            solver.step()
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):  # it is not finite
            code = _ESCAPED if np.abs(solver.y[picked[:2]]).max() > 1.0 else _GAVE_UP
            break
        except _OverBudgetError:
            code = _GAVE_UP
            break
        if str(solver.status) == "failed":
            code = _GAVE_UP
            break
        upto = int(np.searchsorted(times, solver.t + 1e-9, side="right"))
        if upto > filled:
            rows.append(solver.dense_output()(times[filled:upto])[picked].T)
            filled = upto
        if not np.all(np.abs(solver.y[picked[:2]]) < ESCAPED_RAD):
            code = _ESCAPED
            break
    return _stretch(times[:filled], np.vstack(rows), np.array(solver.y), code)


@functools.cache
def _kernels(rhs: Compiled) -> tuple[Compiled, Compiled]:
    """Compile the explicit integrators around one right-hand side."""

    @njit
    def gone(z: Any) -> bool:
        """Whether a joint has left, or a state is not finite."""
        if not (abs(z[0, X1]) < ESCAPED_RAD and abs(z[1, X1]) < ESCAPED_RAD):
            return True
        return not math.isfinite(z.sum())

    @njit
    def fixed(
        start: float, h: float, steps: int, every: int, fourth: bool, z: Any, rows: Any,
        picked: Any, sig: Any, par: Any, motion: Any, fault: Any, mode: Any, forms: Any,
        fit: Any, work: Any,
    ) -> tuple[int, int]:  # fmt: skip
        """Explicit Euler, or the classical Runge-Kutta rule, with a fixed step.

        Returns the status and how many rows were written.
        """
        k1, k2, k3, k4 = (np.empty_like(z), np.empty_like(z), np.empty_like(z), np.empty_like(z))
        flat = z.reshape(z.size)
        written = 0
        for n in range(steps + 1):
            if n % every == 0:
                for c in range(picked.shape[0]):
                    rows[written, c] = flat[picked[c]]
                written += 1
            if n == steps:
                break
            t = start + n * h
            rhs(t, z, k1, sig, par, motion, fault, mode, forms, fit, work)
            if fourth:
                rhs(t + h / 2, z + h / 2 * k1, k2, sig, par, motion, fault, mode, forms, fit, work)
                rhs(t + h / 2, z + h / 2 * k2, k3, sig, par, motion, fault, mode, forms, fit, work)
                rhs(t + h, z + h * k3, k4, sig, par, motion, fault, mode, forms, fit, work)
                z += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            else:
                z += h * k1
            if gone(z):
                return _ESCAPED, written
        return _DONE, written

    # Dormand and Prince's pair, the step control of MATLAB's ode45 with its default
    # tolerances: norm(e / max(|y|, |y_new|, AbsTol/RelTol), inf) <= RelTol.
    rtol, threshold = 1e-3, 1e-3
    a = np.array(
        [
            [1 / 5, 0, 0, 0, 0, 0],
            [3 / 40, 9 / 40, 0, 0, 0, 0],
            [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
            [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
            [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
            [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
        ]
    )
    nodes = np.array([1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
    e = np.array(
        [71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40]
    )  # fmt: skip

    @njit
    def adaptive(
        start: float, end: float, spacing: float, budget: int, z: Any, rows: Any, picked: Any,
        sig: Any, par: Any, motion: Any, fault: Any, mode: Any, forms: Any, fit: Any, work: Any,
    ) -> tuple[int, int]:  # fmt: skip
        """Dormand-Prince 5(4); samples by the cubic through both ends of a step."""
        k = np.empty((7, z.shape[0], z.shape[1]))
        old, flat = np.empty_like(z), z.reshape(z.size)
        largest = 0.1 * (end - start)
        t, h = start, min(largest, 1e-4)
        rhs(t, z, k[0], sig, par, motion, fault, mode, forms, fit, work)
        used, written = 1, 0
        rejected = False
        while True:
            if t >= end - 1e-12:
                for c in range(picked.shape[0]):
                    rows[written, c] = flat[picked[c]]
                return _DONE, written + 1
            if used >= budget or h < 16.0 * np.spacing(t):
                return _GAVE_UP, written
            h = min(h, largest, end - t)
            old[:] = z
            for stage in range(6):
                z[:] = old
                for j in range(stage + 1):
                    z += h * a[stage, j] * k[j]
                rhs(
                    t + nodes[stage] * h, z, k[stage + 1], sig, par, motion, fault, mode, forms,
                    fit, work,
                )  # fmt: skip
            used += 6
            worst = 0.0
            for i in range(z.shape[0]):
                for c in range(z.shape[1]):
                    gap = 0.0
                    for j in range(7):
                        gap += e[j] * k[j, i, c]
                    size = max(abs(old[i, c]), abs(z[i, c]), threshold)
                    worst = max(worst, abs(h * gap) / size)
            if not worst <= rtol:
                z[:] = old
                shrink = 0.5
                if not rejected and math.isfinite(worst):
                    shrink = max(0.1, 0.8 * (rtol / worst) ** 0.2)
                h *= shrink
                rejected = True
                continue
            rejected = False
            before, after = old.reshape(z.size), flat
            slope0, slope1 = k[0].reshape(z.size), k[6].reshape(z.size)
            while written < rows.shape[0] - 1 and start + written * spacing < t + h:
                x = (start + written * spacing - t) / h
                for c in range(picked.shape[0]):
                    at = picked[c]
                    rise = after[at] - before[at]
                    d0, d1 = h * slope0[at] - rise, rise - h * slope1[at]
                    rows[written, c] = before[at] + x * rise + x * (1 - x) * ((1 - x) * d0 + x * d1)
                written += 1
            t += h
            k[0] = k[6]
            h *= min(5.0, 0.8 * (rtol / max(worst, 1e-12)) ** 0.2)
            if gone(z):
                return _ESCAPED, written

    return fixed, adaptive
