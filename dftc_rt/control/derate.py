"""Feedback gains that a joint-by-joint law can hold on a coupled robot with delayed torque.

The law sees M_ii; the robot answers with (M⁻¹) of all joints. Two joints whose axes nearly align
(joints 1 and 3 of a Panda with joint 2 near zero) form a mode of little inertia, which the
feedback of each drives with the inertia of the whole arm: its crossover reaches

    ω_c = max eig( M(q)⁻¹ diag(M_ii (λ_i + k_i)) ),

up to twenty times λ + k. With the dead time T of command, hold and drive, ω_c T must stay below
a phase that leaves a margin, or the mode oscillates. The gains are lowered before the run, for
the joints that take part in the mode and over the whole joint range; nothing changes online.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dftc_rt.control.interface import F64
from dftc_rt.control.layout import Joints

_SAMPLES = 200
_STEPS = 200


def mass_matrix(inverse_dynamics: Callable[[F64, F64, F64], F64], q: F64) -> F64:
    """M(q), (n, n), kg m², column by column from the inverse dynamics.

    Args:
        inverse_dynamics: (q, v, a) to torque, (n,) each.
        q: Position, (n,), rad.
    """
    n = q.shape[0]
    zero = np.zeros(n)
    still = np.array(inverse_dynamics(q, zero, zero))
    columns = [np.array(inverse_dynamics(q, zero, unit)) - still for unit in np.eye(n)]
    matrix = np.stack(columns, axis=1)
    return 0.5 * (matrix + matrix.T)


def crossover(mass: F64, rate: F64) -> tuple[float, F64]:
    """Fastest mode of the velocity feedback.

    Args:
        mass: M(q), (n, n), kg m².
        rate: λ + k, (n,), 1/s.

    Returns:
        Its crossover, rad/s, and each joint's share in it, (n,), largest 1.
    """
    root = np.sqrt(np.diag(mass) * rate)
    values, vectors = np.linalg.eigh(root[:, None] * np.linalg.inv(mass) * root[None, :])
    share: F64 = vectors[:, -1] ** 2
    return float(values[-1]), share / share.max()


def factors(
    inverse_dynamics: Callable[[F64, F64, F64], F64],
    joints: Joints,
    rate: F64,
    lag_s: float,
    phase: float,
) -> F64:
    """Factor for λ and k of each joint, (n,), in (0, 1].

    Args:
        inverse_dynamics: (q, v, a) to torque of the whole robot.
        joints: Ranges, delay and period.
        rate: λ + k before, (n,), 1/s.
        lag_s: Lag of the drives' torque, s.
        phase: Largest crossover times dead time, rad.
    """
    n = rate.shape[0]
    dead = (float(joints.delay_cycles.max()) + 0.5) * joints.period_s + lag_s
    top = phase / dead
    factor = np.ones(n)
    rng = np.random.default_rng(0)
    for _ in range(_SAMPLES):
        mass = mass_matrix(inverse_dynamics, rng.uniform(joints.q_lower, joints.q_upper))
        for _ in range(_STEPS):
            fastest, share = crossover(mass, rate * factor)
            if fastest <= top:
                break
            factor *= 1.0 - share * (1.0 - max(top / fastest, 0.8))
    return factor
