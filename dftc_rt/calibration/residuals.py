"""How far the calibrated model may be believed: variance and colour of y - φ.

The variance of the estimator's measurement y = ρ φ is a sum of independent causes
(:func:`dftc_rt.control.observer.residual_variance`): a floor, velocity noise, and errors in
proportion to the acceleration torque, to the bias torque, and to friction near standstill. Each
is fitted to the squares of y - φ of fault-free runs by non-negative least squares. What is
left, divided by its standard deviation, is correlated in time; the number of samples that carry
the information of one inflates the variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

F64 = NDArray[np.float64]

FADE_RAD_S: Final = (0.02, 0.05, 0.1, 0.2)
"""Velocities over which friction may get certain; the one that explains most is taken."""
_MARGIN: Final = 1.1  # on every standard deviation: other motion than the calibration's
_LEAST_INFLATION: Final = 10.0
_MOST_INFLATION: Final = 2000.0
_SPACING: Final = 10  # cycles; the filters make neighbours alike
_LONGEST_S: Final = 3.0


@dataclass(frozen=True)
class Spread:
    """Statistics of one joint's residual.

    Attributes:
        floor_nm: Floor, Nm.
        velocity_noise: Standard deviation of the measured velocity, rad/s.
        sigma_acc: Relative error of M q̈_d.
        sigma_bias: Relative error of the bias torque.
        friction_nm: Friction error at standstill, Nm.
        v_friction: Velocity over which its standard deviation falls to exp(-1), rad/s.
        inflation: Samples that carry the information of one.
        correlation_s: The same as a time, s.
    """

    floor_nm: float
    velocity_noise: float
    sigma_acc: float
    sigma_bias: float
    friction_nm: float
    v_friction: float
    inflation: float
    correlation_s: float


def velocity_noise(v: F64) -> float:
    """Standard deviation of white noise on a velocity (K,), rad/s, from its third differences.

    The motion itself is smooth over four cycles; the factor is that of white noise.
    """
    return float(np.sqrt(np.mean(np.diff(v, 3) ** 2) / 20.0))


def spread(
    residual: F64,
    inertia: F64,
    bias: F64,
    acc_d: F64,
    v: F64,
    bandwidth: float,
    period_s: float,
    least_floor: float,
) -> Spread:
    """Fit one joint.

    Args:
        residual: y - φ of fault-free motion, filtered, (K,), Nm.
        inertia: M, (K,), kg m².
        bias: (K,), Nm.
        acc_d: q̈_d, (K,), rad/s².
        v: Measured velocity, (K,), rad/s.
        bandwidth: Of the filters, rad/s.
        period_s: Control period, s.
        least_floor: The floor is not below it, Nm: other motion meets other errors.
    """
    noise = velocity_noise(v)
    known = (noise * bandwidth * inertia) ** 2
    square = residual**2
    scale = max(float(square.mean()), 1e-12)
    best: tuple[float, F64, float] | None = None
    thin = slice(None, None, _SPACING)
    for fade in FADE_RAD_S:
        causes = np.stack(
            [np.ones_like(v), (inertia * acc_d) ** 2, bias**2, np.exp(-((v / fade) ** 2))], axis=1
        )
        # Squares scatter in proportion to their size: weigh by the mean level of each sample.
        found = _weighted(causes[thin], (square - known)[thin], scale)
        variance = np.maximum(causes @ found + known, 1e-3 * scale)
        cost = float(np.mean(np.log(variance) + square / variance))
        if best is None or cost < best[0]:
            best = (cost, found, fade)
    assert best is not None
    _, found, fade = best
    floor, acc, of_bias, friction = np.sqrt(found) * _MARGIN
    floor = max(floor, least_floor)
    variance = (
        floor**2 + known + (acc * inertia * acc_d) ** 2 + (of_bias * bias) ** 2
        + (friction * np.exp(-0.5 * (v / fade) ** 2)) ** 2
    )  # fmt: skip
    inflation = colour(residual / np.sqrt(variance), period_s)
    return Spread(
        float(floor), noise, float(acc), float(of_bias), float(friction),
        fade * 2.0**0.5, inflation, inflation * period_s,
    )  # fmt: skip


def _weighted(causes: F64, square: F64, scale: float) -> F64:
    """Non-negative least squares, twice: the second time weighted by the first's variance."""
    weight = np.full(len(square), 1.0 / scale)
    found = np.zeros(causes.shape[1])
    for _ in range(2):
        found, _ = nnls(causes * weight[:, None], square * weight)
        weight = 1.0 / np.maximum(causes @ found, 0.1 * scale)
    solution: F64 = np.asarray(found, dtype=np.float64)
    return solution


def colour(z: F64, period_s: float) -> float:
    """Samples that carry the information of one, from the autocorrelation of z (K,).

    1 + 2 Σ of the autocorrelation until it has fallen to 0.05. Noise that is differentiated,
    whose autocorrelation is negative, counts as white.
    """
    centred = z - z.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return _LEAST_INFLATION
    size = 1 << int(np.ceil(np.log2(2 * centred.size)))
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: round(_LONGEST_S / period_s)] / power
    below = np.flatnonzero(correlation < 0.05)
    end = int(below[0]) if below.size else correlation.size
    total = 1.0 + 2.0 * float(correlation[1:end].sum())
    return min(max(total, _LEAST_INFLATION), _MOST_INFLATION)
