"""Networks f̂_o, ĝ_o of the observer, fitted to rich data of the healthy plant.

On the paper's own run joint 1 of Example 1 stands still, and u hardly moves independently of
the state: f and g u cannot be told apart there (:attr:`Diagnosis.excitation`). So the plant
follows a multisine that covers the range of the judged run and more, without a fault, under a
stabilising controller, and

    v̇_i = Ŵ_fᵀ σ(x) + Ŵ_gᵀ σ(x) u_i

is solved for both sets of weights by ridge least squares. What x is, decides:

* ``local``: x_i alone, as printed. It cannot know what depends on the other joint: the
  spring's force in Example 1, M_11(q_2) in Example 2.
* ``split``: x_i alone, and the interconnection of the split at `desired` added: what the other
  joint at its desired state changes in f and g against the other joint at rest in the upright.
* ``desired``: x_i and the other joint's *desired* position, velocity and acceleration, which
  are stored before the run; no equation of the plant is used.

All are decentralised in operation. Columns are scaled to unit RMS before the ridge, so that
:data:`RIDGE` is relative to what a column contributes; the data are noise-free, so it only has
to keep the weights of neighbouring, nearly equal columns from cancelling each other far beyond
the data, and a held-out motion (another seed) tells whether it does.

Source: [zhao2017] eq. (6), (7), (18), Remark 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from dftc_rt.control.basis import grid_centres
from dftc_rt.dynamics.closed_form.plants import CLOSED_FORMS, ClosedForm
from dftc_rt.errors import InputError
from dftc_rt.paper.closed_loop import Solution
from dftc_rt.paper.examples import EXAMPLES
from dftc_rt.paper.right_hand_side import AD, QD, U_CMD, VD
from dftc_rt.paper.variant import Fitted
from dftc_rt.reference import sines

F64 = NDArray[np.float64]
Form = Literal["local", "split", "desired"]

RIDGE: Final = 1e-7
"""Of the singular values per √sample of columns scaled to unit RMS."""
CENTRES: Final = 100
"""Basis functions of ``desired``, chosen among the data, each farthest from those before."""
WIDTH: Final = 2.5
"""Their width, in half-ranges of an input: wide, for smooth functions of five inputs."""
GRID: Final = (9, 5)
"""Basis functions of the local forms along position and velocity."""
GRID_WIDTH: Final = 2.0
"""Their width, in spacings."""
SEED: Final = 1
"""Of the motion that is fitted."""
HELD_OUT_SEED: Final = 2
"""Of the motion that is not."""
DURATION_S: Final = 80.0
"""Length of a rich run, s."""

_STEP_S = 0.02  # of the integration, and between samples
_SINES: Final = 6
_KP, _KD = 100.0, 20.0  # 1/s², 1/s
# Offset and sum of amplitudes, rad, and highest frequency, rad/s, of the multisine: beyond
# what the judged runs reach after their transient.
_MOTION: Final = {
    1: ((1.0, 0.0), (1.0, 1.9), 2.0),
    2: ((0.0, 0.0), (1.45, 1.45), 3.5),
}


@dataclass(frozen=True)
class Samples:
    """Samples of a healthy run, K in number.

    Attributes:
        example: Number of the example.
        q: Positions, (K, 2), rad.
        v: Velocities, (K, 2), rad/s.
        acc: Accelerations, (K, 2), rad/s².
        u: Torques, (K, 2), Nm.
        desired: Desired position, velocity, acceleration, (K, 3, 2).
    """

    example: int
    q: F64
    v: F64
    acc: F64
    u: F64
    desired: F64


@dataclass(frozen=True)
class Diagnosis:
    """How well a joint's weights are determined by the data, and what they are worth.

    Attributes:
        condition: Condition number of the scaled columns [σ, σ u].
        ridged: The same with the ridge.
        excitation: Share of the variance of u that σ(x) does not explain, 0 to 1; at 0, f
            and g u cannot be told apart.
        residual: RMS residual on the data, rad/s².
        largest: Largest weight.
    """

    condition: float
    ridged: float
    excitation: float
    residual: float
    largest: float


def rich_data(example: int, seed: int = SEED) -> Samples:
    """Simulate the healthy plant along a multisine.

    The controller is computed torque; which one it is does not matter for the fit.

    Args:
        example: 1 or 2.
        seed: Of frequencies, amplitudes and phases.

    Raises:
        InputError: No such example.
    """
    form = _plant(example)
    offset, bound, top = _MOTION[example]
    rng = np.random.default_rng(seed)
    omega = rng.uniform(0.2, top, (2, _SINES))
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, _SINES))
    amp = rng.uniform(0.5, 1.0, (2, _SINES))
    amp *= (np.array(bound) / amp.sum(axis=1))[:, None]
    centre = np.array(offset)
    desired, u = np.empty((3, 2)), np.empty(2)

    def rates(t: float, z: F64) -> F64:
        sines(t, centre, amp, omega, phase, desired)
        wanted = desired[2] + _KP * (desired[0] - z[0]) + _KD * (desired[1] - z[1])
        form.inverse_dynamics(z[0], z[1], wanted, u)
        dz = np.empty((2, 2))
        dz[0] = z[1]
        form.forward_dynamics(z[0], z[1], u, dz[1])
        return dz

    steps = round(DURATION_S / _STEP_S)
    rows = np.empty((steps, 7, 2))
    sines(0.0, centre, amp, omega, phase, desired)
    z, h = desired[:2].copy(), _STEP_S
    for n in range(steps):
        t = n * h
        k1 = rates(t, z)
        row = rows[n]
        row[0], row[1], row[2], row[3], row[4:] = z[0], z[1], k1[1], u, desired
        k2 = rates(t + h / 2, z + h / 2 * k1)
        k3 = rates(t + h / 2, z + h / 2 * k2)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(t + h, z + h * k3))
    q, v, acc, applied = (np.ascontiguousarray(rows[:, c]) for c in range(4))
    return Samples(example, q, v, acc, applied, rows[:, 4:])


def own_data(solution: Solution, start_s: float = 1.0, spacing: int = 10) -> Samples:
    """Samples of the paper's own run before the fault: what its identifier learns from.

    Args:
        solution: Of any variant of the example.
        start_s: The transient before it is left out, s.
        spacing: Every so many samples of the solution.
    """
    example = solution.example.number
    form = _plant(example)
    at = np.flatnonzero(solution.window(start_s, solution.example.fault_s))[::spacing]
    q, v, signals = solution.q[at], solution.v[at], solution.signals[at]
    u, acc = np.ascontiguousarray(signals[:, U_CMD]), np.empty_like(q)
    for k in range(len(at)):
        form.forward_dynamics(q[k], v[k], u[k], acc[k])
    return Samples(example, q, v, acc, u, signals[:, [QD, VD, AD]])


def fit(example: int, form: Form = "desired", samples: Samples | None = None) -> Fitted:
    """Fit both joints' networks.

    Args:
        example: 1 or 2.
        form: What the networks see.
        samples: Data of the healthy plant; None: :func:`rich_data`.

    Raises:
        InputError: No such example.
    """
    return diagnosed(example, form, samples)[0]


def diagnosed(
    example: int, form: Form = "desired", samples: Samples | None = None
) -> tuple[Fitted, tuple[Diagnosis, Diagnosis]]:
    """As :func:`fit`, with a diagnosis for each joint."""
    data = samples or rich_data(example)
    networks, diagnoses = zip(*(_fit_joint(data, joint, form) for joint in range(2)), strict=True)
    centres, inv_width, w_f, w_g = (np.stack(pair) for pair in zip(*networks, strict=True))
    fitted = Fitted(centres, inv_width, w_f, w_g, interconnection=form == "split")
    return fitted, (diagnoses[0], diagnoses[1])


def residual(fitted: Fitted, samples: Samples, joint: int) -> F64:
    """Error f̂ + ĝ u - v̇ of a joint's networks on data, (K,), rad/s²."""
    f_hat, g_hat = outputs(fitted, samples, joint)
    error: F64 = f_hat + g_hat * samples.u[:, joint] - samples.acc[:, joint]
    return error


def outputs(fitted: Fitted, samples: Samples, joint: int) -> tuple[F64, F64]:
    """f̂_o, rad/s², and ĝ_o, 1/(kg m²), of a joint on data, (K,) each."""
    inputs = _inputs(samples, joint, fitted.centres.shape[2])
    sigma = _sigma(inputs, fitted.centres[joint], fitted.inv_width[joint])
    f_hat, g_hat = sigma @ fitted.w_f[joint], sigma @ fitted.w_g[joint]
    if fitted.interconnection:
        more_f, more_g = _interconnection(samples, joint)
        return f_hat + more_f, g_hat + more_g
    return f_hat, g_hat


def _plant(example: int) -> ClosedForm:
    if example not in EXAMPLES:
        raise InputError("example", str(example), "1 or 2")
    return CLOSED_FORMS[EXAMPLES[example].plant]


def _fit_joint(
    data: Samples, joint: int, form: Form
) -> tuple[tuple[F64, F64, F64, F64], Diagnosis]:
    """Centres, inverse widths, Ŵ_f and Ŵ_g of one joint, and the diagnosis."""
    inputs = _inputs(data, joint, 5 if form == "desired" else 2)
    low, high = inputs.min(axis=0), inputs.max(axis=0)
    half = np.maximum((high - low) / 2.0, 1e-3)  # an input that never moved
    if form == "desired":
        centres, inv_width = _farthest(inputs, half), 1.0 / (WIDTH * half)
    else:
        speed = np.abs(inputs[:, 1]).max(keepdims=True)
        centres = grid_centres(low[:1], high[:1], speed, *GRID)[0]
        spacing = np.array([high[0] - low[0], 2.0 * speed[0]]) / (np.array(GRID) - 1.0)
        inv_width = 1.0 / (GRID_WIDTH * np.maximum(spacing, 1e-3))
    u, target = data.u[:, joint], data.acc[:, joint]
    if form == "split":
        more_f, more_g = _interconnection(data, joint)
        target = target - more_f - more_g * u
    sigma = _sigma(inputs, centres, inv_width)
    columns = np.hstack([sigma, sigma * u[:, None]])
    weights, values = _ridge(columns, target)
    unexplained = u - sigma @ _ridge(sigma, u)[0]
    diagnosis = Diagnosis(
        condition=float(values[0] / max(values[-1], 1e-300)),
        ridged=float(np.hypot(values[0], RIDGE) / np.hypot(values[-1], RIDGE)),
        excitation=float(np.mean(unexplained**2) / np.var(u)),
        residual=float(np.sqrt(np.mean((columns @ weights - target) ** 2))),
        largest=float(np.abs(weights).max()),
    )
    m = len(centres)
    return (centres, inv_width, weights[:m], weights[m:]), diagnosis


def _ridge(columns: F64, target: F64) -> tuple[F64, F64]:
    """Weights of the scaled ridge regression, and singular values per √sample."""
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    left, values, right = np.linalg.svd(columns / scale, full_matrices=False)
    values = values / np.sqrt(len(target))
    projected = left.T @ target / np.sqrt(len(target))
    return right.T @ (values / (values**2 + RIDGE**2) * projected) / scale, values


def _inputs(data: Samples, joint: int, count: int) -> F64:
    """Inputs of a joint's networks, (K, count): 2 local ones, 5 with the other's desired."""
    own = [data.q[:, joint], data.v[:, joint]]
    return np.stack([*own, *data.desired[:, :, 1 - joint].T][:count], axis=1)


def _sigma(inputs: F64, centres: F64, inv_width: F64) -> F64:
    """σ of every sample, (K, m)."""
    distance = (inputs[:, None, :] - centres) * inv_width
    sigma: F64 = np.exp(-0.5 * np.sum(distance**2, axis=2))
    return sigma


def _farthest(inputs: F64, half: F64) -> F64:
    """:data:`CENTRES` of the inputs, each the farthest from those before, (m, d)."""
    scaled = inputs / half
    chosen = [0]
    gap = np.full(len(scaled), np.inf)
    for _ in range(CENTRES - 1):
        gap = np.minimum(gap, np.sum((scaled - scaled[chosen[-1]]) ** 2, axis=1))
        chosen.append(int(gap.argmax()))
    centres: F64 = inputs[chosen]
    return centres


def _interconnection(data: Samples, joint: int) -> tuple[F64, F64]:
    """What the other joint at `desired` adds to f and g, against `frozen`, (K,) each.

    Source: [zhao2017] eq. (36).
    """
    form = _plant(data.example)
    work, inertia, bias, rest = np.empty((6, 2)), np.empty(2), np.empty(2), np.zeros(2)
    f, g = np.empty((2, len(data.q))), np.empty((2, len(data.q)))
    desired = np.ascontiguousarray(data.desired)
    for k, (q, v) in enumerate(zip(data.q, data.v, strict=True)):
        for row, other in enumerate(((rest, rest, rest), desired[k])):
            form.local_terms(q, v, other[0], other[1], other[2], work, inertia, bias)
            f[row, k], g[row, k] = -bias[joint] / inertia[joint], 1.0 / inertia[joint]
    return f[1] - f[0], g[1] - g[0]
