"""The shipped law in discrete time against a continuous plant, as one compiled loop.

The law is stepped by its own kernel, :data:`dftc_rt.control.kernel.CYCLE`, once a period. Its
torque is held until the next one, without lag, delay or noise; the closed-form plant moves on
in between by several steps of RK4, so that only the sampling of the law is seen.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt import reference
from dftc_rt.control import basis, layout, rates
from dftc_rt.control.kernel import CYCLE
from dftc_rt.control.layout import W_G
from dftc_rt.control.signals import AD, NAMES, QD, RHO_HAT, TAU_CMD, VD, Q, V
from dftc_rt.dynamics.closed_form import arm2, pendulums

F64 = NDArray[np.float64]

_CACHE = {"cache": True, "fastmath": False, "nogil": True}
_ROWS = len(NAMES)

PENDULUMS: Final = 0
ARM: Final = 1
PLANTS: Final = {"pendulums": PENDULUMS, "arm2": ARM}
"""Plants of the two examples, by the names of the closed forms."""

EVENTS: Final = ("ĝ ≈ 0", "δ̂ + ξ̂", "ρ̂", "e_2o", "torque", "e", "not finite")
"""Signals that are held against a limit each, in the order in which one drags along the next."""
G_HAT, BOUNDS, RHO, E_2O, TORQUE, E, FINITE = range(7)
LIMITS: Final = (1e-3, 1e4, 1e3, 1e3, 1e6, 10.0, 0.5)
"""Their limits: 1/(kg m²) (from above), rad/s², 1, rad/s, Nm, rad; status of the kernel."""

E_SUM, CHANGE_SUM, RHO_SUM = range(3)
"""Squares summed in a window: e, rad²; change of the torque from cycle to cycle, Nm²; ρ̂ - ρ."""


@njit(**_CACHE)
def accelerate(plant: int, q: F64, v: F64, tau: F64, out: F64) -> None:
    """Acceleration (2,), rad/s², of a plant under the torque ``tau`` (2,), Nm."""
    if plant == PENDULUMS:
        pendulums.state_form_forward_dynamics(q, v, tau, out)
    else:
        arm2.forward_dynamics(q, v, tau, out)


@njit(**_CACHE)
def advance(plant: int, q: F64, v: F64, tau: F64, span: float, steps: int, work: F64) -> None:
    """Move the plant on under a held torque.

    Args:
        plant: :data:`PENDULUMS` or :data:`ARM`.
        q: Positions, (2,), rad, updated in place.
        v: Velocities, (2,), rad/s, updated in place.
        tau: Torque, (2,), Nm.
        span: Time, s.
        steps: Steps of RK4 that it is divided into.
        work: Scratch, (6, 2).
    """
    h = span / steps
    a1, a2, a3, a4, x, w = work[0], work[1], work[2], work[3], work[4], work[5]
    for _ in range(steps):
        accelerate(plant, q, v, tau, a1)
        for i in range(2):
            x[i], w[i] = q[i] + 0.5 * h * v[i], v[i] + 0.5 * h * a1[i]
        accelerate(plant, x, w, tau, a2)
        for i in range(2):
            x[i], w[i] = q[i] + 0.5 * h * (v[i] + 0.5 * h * a1[i]), v[i] + 0.5 * h * a2[i]
        accelerate(plant, x, w, tau, a3)
        for i in range(2):
            x[i], w[i] = q[i] + h * (v[i] + 0.5 * h * a2[i]), v[i] + h * a3[i]
        accelerate(plant, x, w, tau, a4)
        for i in range(2):
            q[i] += h * (v[i] + h * (a1[i] + a2[i] + a3[i]) / 6.0)
            v[i] += h * (a1[i] + 2.0 * a2[i] + 2.0 * a3[i] + a4[i]) / 6.0


@njit(**_CACHE)
def split(
    plant: int, q: F64, v: F64, desired: F64, inertia: F64, bias: F64, work: F64
) -> None:  # fmt: skip
    """M_i, kg m², and bias, Nm, (2,) each, of the split (36) with the other joint as desired.

    Args:
        plant: :data:`PENDULUMS` or :data:`ARM`.
        q: Positions, (2,), rad.
        v: Velocities, (2,), rad/s.
        desired: Desired position, velocity, acceleration, (3, 2).
        inertia: Written.
        bias: Written.
        work: Scratch, (6, 2).
    """
    state, tau, mass = work[:3], work[3], work[4:]
    for i in range(2):
        state[:] = desired
        state[0, i], state[1, i], state[2, i] = q[i], v[i], 0.0
        if plant == PENDULUMS:
            pendulums.state_form_mass_matrix(desired[0], mass)
            pendulums.state_form_inverse_dynamics(state[0], state[1], state[2], tau)
        else:
            arm2.mass_matrix(desired[0], mass)
            arm2.inverse_dynamics(state[0], state[1], state[2], tau)
        inertia[i], bias[i] = mass[i, i], tau[i]


@njit(**_CACHE)
def beyond(n: int, rec: F64, i: int, status: int, p: Any, x: Any, g_hat: float) -> bool:
    """Whether signal ``n`` of :data:`EVENTS` of joint i is beyond its limit, or not a number."""
    value = float(status)
    if n == G_HAT:
        return not abs(g_hat) >= LIMITS[G_HAT]
    if n == BOUNDS:
        value = x.delta + x.xi
    elif n == RHO:
        value = abs(x.rho)
    elif n == E_2O:
        value = abs(rec[V, i] - x.x2o) if p.identifier > 0 else 0.0
    elif n == TORQUE:
        value = abs(rec[TAU_CMD, i])
    elif n == E:
        value = abs(rec[Q, i] - rec[QD, i])
    return not value <= LIMITS[n]


@njit(**_CACHE)
def loop(
    plant: int,
    law: Any,
    arguments: Any,
    uses_split: bool,
    period: float,
    cycles: int,
    substeps: int,
    motion: Any,
    fault: F64,
    windows: F64,
    q: F64,
    v: F64,
    first: F64,
    sums: F64,
    counts: F64,
    largest: F64,
    every: int,
    samples: F64,
) -> int:
    """Run a law, see :data:`LOOP`."""
    done = cycles
    par, st, weights, centres, sigma = law
    offset, amplitude, omega, phase = motion
    rec, desired = np.zeros((_ROWS, 2)), np.zeros((3, 2))
    inertia, bias, tau, last = np.ones(2), np.zeros(2), np.zeros(2), np.zeros(2)
    work = np.zeros((6, 2))
    for k in range(cycles):
        t = k * period
        reference.sines(t, offset, amplitude, omega, phase, desired)
        for i in range(2):
            rec[Q, i], rec[V, i] = q[i], v[i]
            rec[QD, i], rec[VD, i], rec[AD, i] = desired[0, i], desired[1, i], desired[2, i]
        if uses_split:
            split(plant, q, v, desired, inertia, bias, work)
        status = CYCLE(rec, inertia, bias, *arguments)
        rho1 = 1.0
        if t >= fault[0]:
            rho1 = fault[1] + fault[2] * math.cos(fault[3] * t)
        stop = False
        for i in range(2):
            p, x = par[i], st[i]
            g_hat = LIMITS[G_HAT]
            if not p.g_min >= g_hat and first[G_HAT, i] > t:
                basis.gaussian(q[i], v[i], centres[i], p.inv_width1, p.inv_width2, sigma)
                wg = basis.network(weights[i, W_G], sigma)
                g_hat = rates.models(p, inertia[i], 0.0, 0.0, wg)[1]
            for n in range(first.shape[0]):
                if first[n, i] > t and beyond(n, rec, i, status, p, x, g_hat):
                    first[n, i] = t
                    stop = stop or n >= TORQUE or n == RHO
            u, e = rec[TAU_CMD, i], rec[Q, i] - rec[QD, i]
            largest[i] = max(largest[i], abs(u))
            miss = rec[RHO_HAT, i] - (rho1 if i == 0 else 1.0)
            for n in range(windows.shape[0]):
                if windows[n, 0] <= t < windows[n, 1]:
                    sums[n, E_SUM, i] += e * e
                    sums[n, CHANGE_SUM, i] += (u - last[i]) * (u - last[i])
                    sums[n, RHO_SUM, i] += miss * miss
                    counts[n, i] += 1.0
            last[i] = u
            if k % every == 0:
                samples[k // every, 0, i], samples[k // every, 1, i] = e, u
                samples[k // every, 2, i] = x.delta + x.xi
                samples[k // every, 3, i] = rec[RHO_HAT, i]
        if stop:
            done = k
            break
        tau[0], tau[1] = rho1 * rec[TAU_CMD, 0], rec[TAU_CMD, 1]
        advance(plant, q, v, tau, period, substeps, work)
    return done


def arguments(store: layout.Storage) -> tuple[Any, ...]:
    """Arguments of the kernel after ``rec``, M and bias, in its order; the joints carry no load.

    Args:
        store: Arrays of the law.
    """
    by_name = {
        "load": np.zeros(store.parameters.shape[0]), "par": store.parameters, "st": store.state,
        "w": store.weights, "c": store.centres, "sigma": store.sigma, "history": store.history,
        "moments": store.moments, "correlations": store.correlations, "sums": store.sums,
    }  # fmt: skip
    kernel: Any = CYCLE
    names = list(inspect.signature(kernel.py_func).parameters)[3:]
    return tuple(by_name[name] for name in names)


LOOP: Final[Callable[..., int]] = loop
"""Run a law; returns the cycles that were run, fewer than ``cycles`` after a divergence.

Args:
    plant: :data:`PENDULUMS` or :data:`ARM`.
    law: Parameters, states, weights, centres and scratch of the law, to be looked at.
    arguments: From :func:`arguments`.
    uses_split: Whether the law reads M and bias; else they are 1 and 0.
    period: Of the law, s.
    cycles: How many.
    substeps: Steps of RK4 in a period.
    motion: Arguments of :func:`dftc_rt.reference.sines`.
    fault: Start, s, then mean, amplitude and angular frequency, rad/s, of ρ_1, (4,).
    windows: Start and end of each window in which squares are summed, (2, 2), s.
    q: Positions, (2,), rad, updated in place.
    v: Velocities, (2,), rad/s, updated in place.
    first: When each signal was first beyond its limit, (events, 2), s; infinite at the start.
    sums: (2, 3, 2), added to.
    counts: Cycles in each window, (2, 2), added to.
    largest: Largest torque as told, (2,), Nm.
    every: Cycles between two samples.
    samples: e, u as told, δ̂ + ξ̂ and ρ̂, (cycles // every + 1, 4, 2), written.
"""
