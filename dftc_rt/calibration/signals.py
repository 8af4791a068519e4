"""Motion and torque of a log, on one time base and filtered alike.

A command acts from the SYNC after it was sent, through the drive's lag; the position is that
of a SYNC. Both sides of the regression go through the same zero-phase low pass, so that it
adds no delay and takes nothing from one side that the other keeps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from dftc_rt.control import observer
from dftc_rt.dynamics.friction import STICTION_RAD_S
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]

CUTOFF_HZ: Final = 8.0
"""Low pass of the regression: well above a multisine's motion, well below the drive's lag."""
_ORDER: Final = 3
_SKIP_S: Final = 0.5  # at both ends, where the filter has no neighbours
_SPACING_S: Final = 0.02  # of the samples that are kept: the filter leaves no more information


@dataclass(frozen=True)
class Motion:
    """Filtered samples of one fault-free run, K in number.

    Attributes:
        q: (K, n), rad.
        v: (K, n), rad/s.
        a: (K, n), rad/s².
        torque: (K, n): what a drive with a right torque constant delivered, Nm.
        sign: (K, n): tanh(v / v_s) as in :mod:`dftc_rt.dynamics.friction`, filtered likewise.
    """

    q: F64
    v: F64
    a: F64
    torque: F64
    sign: F64


@njit(cache=True)
def _delivered(command: F64, delay: NDArray[np.int64], weight: F64, decay: F64, out: F64) -> None:
    """Mean torque over the period that ends at each SYNC, for a command sent after SYNC k."""
    count, n = command.shape
    for i in range(n):
        applied = 0.0
        for k in range(count):
            sent = k - 1 - delay[i]
            u = command[sent, i] if sent >= 0 else 0.0
            out[k, i], applied = observer.lagged(applied, u, weight[i], decay[i])


def delivered(command: F64, period_s: float, delay_cycles: NDArray[np.int64], lag_s: F64) -> F64:
    """Torque that healthy drives delivered, (K, n), Nm: the mean over the period before a SYNC.

    Args:
        command: Torque as sent, (K, n), Nm.
        period_s: Control period, s.
        delay_cycles: Cycles from a command to the SYNC that actuates it, (n,).
        lag_s: First-order lag of the drives' torque, (n,), s.
    """
    lags = lag_s > 0.0
    lag = np.where(lags, lag_s, period_s)
    decay = np.where(lags, np.exp(-period_s / lag), 0.0)
    weight = np.where(lags, lag / period_s * -np.expm1(-period_s / lag), 0.0)
    out = np.empty_like(command)
    _delivered(np.ascontiguousarray(command), delay_cycles, weight, decay, out)
    return out


def motion(q: F64, v: F64, torque: F64, period_s: float, skip_s: float) -> Motion:
    """Filter and thin out one run.

    Args:
        q: Measured positions, one a cycle, (K, n), rad.
        v: Measured velocities, (K, n), rad/s.
        torque: From :func:`delivered`, (K, n), Nm.
        period_s: Control period, s.
        skip_s: Leave out the beginning: the blend-in, s.

    Raises:
        InputError: The run is too short.
    """
    edge = round(_SKIP_S / period_s)
    start = round(skip_s / period_s) + edge
    if len(q) < start + edge + round(1.0 / period_s):
        found = f"{len(q) * period_s:.2f} s"
        raise InputError("calibration", found, f"more than {skip_s + 2 * _SKIP_S + 1.0:.2f} s")
    sos = butter(_ORDER, 2.0 * CUTOFF_HZ * period_s, output="sos")

    def low_pass(x: F64) -> F64:
        y: F64 = sosfiltfilt(sos, x, axis=0)
        return y

    smooth = low_pass(v)
    centred = 0.5 * (torque + np.vstack([torque[1:], torque[-1:]]))  # about the SYNC, as q and v
    kept = slice(start, len(q) - edge, max(round(_SPACING_S / period_s), 1))
    acceleration = np.gradient(smooth, period_s, axis=0)
    sign = low_pass(np.tanh(smooth / STICTION_RAD_S))
    return Motion(
        low_pass(q)[kept], smooth[kept], acceleration[kept], low_pass(centred)[kept], sign[kept]
    )
