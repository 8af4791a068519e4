"""Least squares for what the URDF does not know: load, friction, armature, torque constant.

For joint i, with the nominal torque τ_i, the regressor Y_i of the last links' inertial
parameters and the torque u_i that a right torque constant would have delivered,

    κ_i u_i = τ_i + Y_i Δθ + ΔI_i q̈_i + fv_i q̇_i + fc_i tanh(q̇_i/v_s) + fo_i

The true torque constant is κ_i times the nominal one. The equation is divided by κ_i, so that u_i
stands alone: with κ_i at u_i, all parameters at zero would be a perfect fit. α_i = 1/κ_i - 1
multiplies τ_i + Y_i Δθ, a product of unknowns, and the fit is iterated. Friction, offset and
armature are estimated divided by κ_i as well and multiplied again at the end.

Ridge: each parameter has a prior of mean 0 (the nominal robot) whose standard deviation is what
is plausible; what the data do not excite is held at the nominal value, and named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.calibration import physical
from dftc_rt.calibration.signals import Motion
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.regressor import PARAMETERS, inertial_parameters, rows
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]

FRICTION: Final = ("viscous", "coulomb", "offset", "armature", "torque_constant")
"""Parameters of a joint, in the order of their blocks."""

_LOAD_STD: Final = np.array([5.0, 1.0, 1.0, 1.0, *[0.3] * 6])  # kg, kg m, kg m²
_ITERATIONS: Final = 8
_LEAST_NOISE: Final = 2e-4  # of the torque limit: below it the model, not the noise, is the limit
_EXCITED: Final = 0.5  # of the prior's standard deviation: above it the data said little
_HELD: Final = 1e-6
_LAGS: Final = 100


@dataclass(frozen=True)
class Fit:
    """Result of the regression for n joints and L last links.

    Attributes:
        load: Inertial parameters of the last links, (L, 10), physical.
        load_std: Their standard errors, (L, 10).
        values: By name of :data:`FRICTION`, (n,): Nm s/rad, Nm, Nm, kg m² (the whole armature),
            1 (true over nominal torque constant).
        std: Standard errors of these, (n,) each.
        residual: RMS of what is left, (n,), Nm.
        not_excited: Names of parameters that the data did not determine, by joint index.
        samples: Samples used.
    """

    load: F64
    load_std: F64
    values: dict[str, F64]
    std: dict[str, F64]
    residual: F64
    not_excited: tuple[tuple[str, ...], ...]
    samples: int


def fit(robot: Robot, runs: Sequence[Motion], torque_limit: F64) -> Fit:
    """Fit all joints together.

    Args:
        robot: The nominal robot.
        runs: Fault-free runs.
        torque_limit: (n,), Nm; scales priors and residuals.

    Raises:
        InputError: No run, or the robot did not move.
    """
    n = robot.n
    if not runs:
        raise InputError("calibration", "no run", "one or more fault-free runs")
    q, v, a, torque, sign = (
        np.concatenate([getattr(run, name) for run in runs])
        for name in ("q", "v", "a", "torque", "sign")
    )
    if float(np.abs(v).max()) < 1e-3:
        raise InputError("calibration", "the robot stands still", "a run in which it moves")
    nominal, regressor = rows(robot, q, v, a)
    loads = regressor.shape[2]
    joint = np.arange(n)
    linear = np.zeros((*q.shape, loads + 5 * n))
    for block, column in enumerate((v, sign, np.ones_like(v), a)):
        linear[:, joint, loads + block * n + joint] = column
    prior = np.concatenate(
        [np.tile(_LOAD_STD, loads // PARAMETERS), *_friction_std(robot, torque_limit)]
    )
    problem = _Problem(linear, torque, nominal, regressor, torque_limit)
    x, normal = problem.solve(prior)
    std = np.sqrt(np.diag(np.linalg.inv(normal)))
    poor = (std > _EXCITED * prior) & (np.arange(prior.size) >= loads)
    if poor.any():  # what the motion does not tell stays nominal, and bends nothing else
        x, normal = problem.solve(np.where(poor, _HELD * prior, prior))
        std = np.where(poor, std, np.sqrt(np.diag(np.linalg.inv(normal))))
    x = physical.nearest(x, normal, inertial_parameters(robot))
    left = problem.target - linear @ x
    alpha = slice(loads + 4 * n, None)
    scale = 1.0 / (1.0 + x[alpha])  # κ
    blocks = {name: slice(loads + k * n, loads + (k + 1) * n) for k, name in enumerate(FRICTION)}
    values = {name: x[block] * scale for name, block in blocks.items()}
    values["torque_constant"] = scale
    values["viscous"] = np.maximum(values["viscous"], 0.0)
    values["coulomb"] = np.maximum(values["coulomb"], 0.0)
    values["armature"] = np.maximum(robot.armature + values["armature"], 0.0)
    errors = {name: std[block] * scale for name, block in blocks.items()}
    errors["torque_constant"] = std[alpha] * scale**2
    return Fit(
        inertial_parameters(robot) + x[:loads].reshape(-1, PARAMETERS),
        std[:loads].reshape(-1, PARAMETERS),
        values,
        errors,
        np.sqrt(np.mean(left**2, axis=0)),
        tuple(tuple(name for name in FRICTION if poor[blocks[name]][i]) for i in range(n)),
        q.size,
    )


class _Problem:
    """The iterated, weighted ridge regression.

    Attributes:
        target: Torque that the parameters have to explain, (K, n), Nm.
    """

    def __init__(
        self, linear: F64, torque: F64, nominal: F64, regressor: F64, torque_limit: F64
    ) -> None:
        self._linear = linear
        self._torque = torque
        self._nominal = nominal
        self._regressor = regressor
        self._limit = torque_limit
        self.target = torque - nominal

    def solve(self, prior: F64) -> tuple[F64, F64]:
        """Parameters and their normal matrix, for prior standard deviations."""
        linear, loads, n = self._linear, self._regressor.shape[2], self._limit.size
        joint = np.arange(n)
        alpha = slice(loads + 4 * n, None)
        x = np.zeros(linear.shape[2])
        noise = np.full(n, 0.005)
        colour = np.ones(n)
        normal = np.eye(x.size)
        for _ in range(_ITERATIONS):
            loaded = self._regressor @ x[:loads]
            linear[:, :, :loads] = self._regressor * (1.0 + x[alpha])[:, None]
            linear[:, joint, loads + 4 * n + joint] = self._nominal + loaded
            # The product of load and torque constant is in both columns: count it once.
            self.target = self._torque - self._nominal + x[alpha] * loaded
            weight = 1.0 / (self._limit * noise * np.sqrt(colour))
            normal, right = _normal(linear * weight[:, None], self.target * weight, prior)
            x[:] = np.linalg.solve(normal, right)
            left = self.target - linear @ x
            noise[:] = np.maximum(left.std(axis=0) / self._limit, _LEAST_NOISE)
            colour[:] = [_colour(left[:, i]) for i in range(n)]
        return x, normal


def _friction_std(robot: Robot, torque_limit: F64) -> tuple[F64, ...]:
    """Prior standard deviations, one (n,) for each block of :data:`FRICTION`."""
    return (
        0.05 * torque_limit,
        0.05 * torque_limit,
        0.02 * torque_limit,
        0.5 * robot.armature + 0.02,
        np.full(robot.n, 0.1),
    )


def _normal(matrix: F64, target: F64, prior: F64) -> tuple[F64, F64]:
    """Normal equations of a ridge regression, per-sample rows flattened."""
    flat = matrix.reshape(-1, matrix.shape[-1])
    return flat.T @ flat + np.diag(1.0 / prior**2), flat.T @ target.ravel()


def _colour(residual: F64) -> float:
    """Samples that carry the information of one: 1 + 2 Σ autocorrelation, up to its zero."""
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, min(_LAGS, centred.size - 1)):
        correlation = float(centred[lag:] @ centred[:-lag]) / power
        if correlation <= 0.0:
            break
        total += 2.0 * correlation
    return total
