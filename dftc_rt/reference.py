"""Desired motion: position, velocity and acceleration of every joint at a time.

Every kind becomes one of two forms, each with exact derivatives: a sum of sines, or
a piecewise polynomial of degree five. Both are blended in from the measured pose.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from dftc_rt.config.scenario import ReferenceTable
from dftc_rt.errors import InputError, MissingFileError

F64 = NDArray[np.float64]

_LEAST_S: Final = 1e-4  # between two moments of a motion: a period at the highest rate
_LARGEST: Final = 1e6  # position or time: beyond it nothing is meant, and powers overflow


@numba.njit(cache=True)
def sines(t: float, offset: F64, amp: F64, omega: F64, phase: F64, out: F64) -> None:
    """Write rows q, v, a of a sum of sines into ``out`` (3, n).

    Args:
        t: Time, s.
        offset: Centre, (n,), rad.
        amp: Amplitudes, (n, sines), rad.
        omega: Angular frequencies, (n, sines), rad/s.
        phase: Phases at t = 0, (n, sines), rad.
        out: Written, rad, rad/s, rad/s².
    """
    for i in range(offset.shape[0]):
        q, v, a = offset[i], 0.0, 0.0
        for h in range(amp.shape[1]):
            w = omega[i, h]
            angle = w * t + phase[i, h]
            s, c = amp[i, h] * np.sin(angle), amp[i, h] * np.cos(angle)
            q += s
            v += w * c
            a -= w * w * s
        out[0, i], out[1, i], out[2, i] = q, v, a


@numba.njit(cache=True)
def _polynomial(t: float, knots: F64, coef: F64, out: F64) -> None:
    """Write rows q, v, a of a piecewise quintic into ``out`` (3, n); at rest outside."""
    last = knots.shape[0] - 1
    inside = t >= knots[0] and t <= knots[last]
    clamped = min(max(t, knots[0]), knots[last])
    k = min(max(np.searchsorted(knots, clamped, side="right") - 1, 0), last - 1)
    x = clamped - knots[k]
    for i in range(coef.shape[1]):
        c = coef[k, i]
        out[0, i] = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))
        if inside:
            out[1, i] = c[1] + x * (2 * c[2] + x * (3 * c[3] + x * (4 * c[4] + x * 5 * c[5])))
            out[2, i] = 2 * c[2] + x * (6 * c[3] + x * (12 * c[4] + x * 20 * c[5]))
        else:
            out[1, i] = 0.0
            out[2, i] = 0.0


@numba.njit(cache=True)
def _blend(t: float, blend_s: float, q0: F64, out: F64) -> None:
    """Blend ``out`` (3, n) in from rest at ``q0`` with a quintic over ``blend_s``."""
    if t >= blend_s:
        return
    x = max(t, 0.0) / blend_s
    b = x * x * x * (10.0 + x * (-15.0 + 6.0 * x))
    db = x * x * (30.0 + x * (-60.0 + 30.0 * x)) / blend_s
    ddb = x * (60.0 + x * (-180.0 + 120.0 * x)) / (blend_s * blend_s)
    for i in range(q0.shape[0]):
        d, v, a = out[0, i] - q0[i], out[1, i], out[2, i]
        out[0, i] = q0[i] + b * d
        out[1, i] = db * d + b * v
        out[2, i] = ddb * d + 2.0 * db * v + b * a


@numba.njit(cache=True)
def stop_ramp(t: float, ramp_s: float, start: F64, out: F64) -> None:
    """Come to rest: velocity falls smoothly to zero within ``ramp_s``.

    Args:
        t: Time since the ramp began, s.
        ramp_s: Its duration, s.
        start: Desired position and velocity when it began, rows 0 and 1, (2+, n).
        out: Desired position, velocity, acceleration, (3, n).
    """
    x = min(max(t / ramp_s, 0.0), 1.0)
    for i in range(out.shape[1]):
        v0 = start[1, i]
        out[0, i] = start[0, i] + v0 * ramp_s * (x - x * x * x + 0.5 * x * x * x * x)
        out[1, i] = v0 * (1.0 - x * x * (3.0 - 2.0 * x))
        out[2, i] = v0 * (-6.0 * x + 6.0 * x * x) / ramp_s


class Reference:
    """Desired motion of n joints.

    Attributes:
        n: Number of joints.
    """

    def __init__(self, table: ReferenceTable, home: F64) -> None:
        """Build the motion.

        Args:
            table: The scenario's ``[reference]``.
            home: Pose about which the motion is centred, (n,), rad.

        Raises:
            InputError: A value does not fit the robot or the kind.
        """
        if 0.0 < table.blend_s < _LEAST_S:
            raise InputError(
                "reference.blend_s", f"found {table.blend_s:g}", f"0, or {_LEAST_S:g} or more"
            )
        self.n = home.shape[0]
        self._blend_s = table.blend_s
        self._q0 = home.copy()
        self._sine_form: tuple[F64, F64, F64, F64] | None = None
        self._poly_form: tuple[F64, F64] | None = None
        build = _BUILDERS[table.kind]
        form = build(table, home)
        if len(form) == 4:
            self._sine_form = form
        else:
            self._poly_form = form
        self.sample(0.0, np.empty((3, self.n)))

    def start(self, q0: F64) -> None:
        """Blend in from the measured pose ``q0`` (n,), rad, at t = 0."""
        self._q0[:] = q0

    def sample(self, t: float, out: F64) -> None:
        """Write desired position, velocity, acceleration at ``t`` into ``out`` (3, n).

        Real-time safe: no allocation.
        """
        self.target(t, out)
        if t < self._blend_s:
            _blend(t, self._blend_s, self._q0, out)

    def target(self, t: float, out: F64) -> None:
        """Write the motion that is blended in, as if it had always been followed.

        Same form as :meth:`sample`, and as safe in real time.
        """
        if self._sine_form is not None:
            sines(t, *self._sine_form, out)
        elif self._poly_form is not None:
            _polynomial(t, *self._poly_form, out)

    @property
    def harmonics(self) -> tuple[F64, F64, F64, F64] | None:
        """Arguments of :func:`sines` besides t and out; None if it is no sum of sines."""
        return self._sine_form

    def table(self, times: F64) -> F64:
        """Return the motion at ``times`` (K,) as an array (K, 3, n)."""
        out = np.empty((times.shape[0], 3, self.n))
        for k in range(times.shape[0]):
            self.sample(float(times[k]), out[k])
        return out


def _per_joint(value: float | tuple[float, ...], n: int, key: str) -> F64:
    values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if values.size not in (1, n):
        raise InputError(f"reference.{key}", f"{values.size} values", f"1 or {n}, one per joint")
    return np.broadcast_to(values, (n,)).copy()


def _hold(table: ReferenceTable, home: F64) -> tuple[F64, ...]:
    zero = np.zeros((home.shape[0], 1))
    return home.copy(), zero, zero, zero


def _sine(table: ReferenceTable, home: F64) -> tuple[F64, ...]:
    n = home.shape[0]
    if isinstance(table.frequency_hz, tuple):
        raise InputError("reference.frequency_hz", "a range", "one number for kind 'sine'")
    amp = _per_joint(table.amplitude_rad, n, "amplitude_rad")[:, None]
    omega = np.full((n, 1), 2 * np.pi * table.frequency_hz)
    return home.copy(), amp, omega, np.zeros((n, 1))


def _multisine(table: ReferenceTable, home: F64) -> tuple[F64, ...]:
    """Sum of sines with random frequencies and phases; the peak is bounded by the amplitude."""
    n, m = home.shape[0], table.sines
    band = (
        table.frequency_hz if isinstance(table.frequency_hz, tuple) else (table.frequency_hz,) * 2
    )
    if len(band) != 2 or band[0] > band[1]:
        raise InputError("reference.frequency_hz", f"{list(band)}", "[lowest, highest]")
    low, high = band
    rng = np.random.default_rng(table.seed)
    omega = 2 * np.pi * rng.uniform(low, high, (n, m))
    phase = rng.uniform(0, 2 * np.pi, (n, m))
    amp = np.repeat(_per_joint(table.amplitude_rad, n, "amplitude_rad")[:, None] / m, m, axis=1)
    return home.copy(), amp, omega, phase


def _waypoints(table: ReferenceTable, home: F64) -> tuple[F64, ...]:
    """Rest-to-rest minimum-jerk moves between poses."""
    n = home.shape[0]
    times = np.asarray(table.times_s, dtype=np.float64)
    if times.size < 2 or np.any(np.diff(times) <= 0):
        raise InputError("reference.times_s", f"{table.times_s}", "two or more rising times")
    if len(table.positions_rad) != times.size or any(len(p) != n for p in table.positions_rad):
        raise InputError(
            "reference.positions_rad", "wrong shape", f"{times.size} poses of {n} joints"
        )
    poses = np.asarray(table.positions_rad, dtype=np.float64)
    _refuse_extremes(times, poses, "reference")
    coef = np.zeros((times.size - 1, n, 6))
    for k, span in enumerate(np.diff(times)):
        d = poses[k + 1] - poses[k]
        coef[k, :, 0] = poses[k]
        coef[k, :, 3], coef[k, :, 4], coef[k, :, 5] = (
            10 * d / span**3,
            -15 * d / span**4,
            6 * d / span**5,
        )
    return times, coef


def _csv(table: ReferenceTable, home: F64) -> tuple[F64, ...]:
    """Cubic spline through the rows ``t, q_1, …, q_n`` of a file with one header line."""
    n = home.shape[0]
    if table.file is None:
        raise InputError("reference.file", "missing", "the path of a CSV file for kind 'csv'")
    path = Path(table.file)
    if not path.is_file():
        raise MissingFileError("reference.file", f"no file '{path}'", "a CSV file t,q_1,…,q_n")
    rows: list[list[float]] = []
    try:
        lines = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(str(path), f"cannot be read: {error}", "a CSV file t,q_1,…,q_n") from None
    for number, row in enumerate(lines, start=1):
        if number == 1:
            continue
        try:
            values = [float(x) for x in row]
        except ValueError:
            values = []
        if len(values) != n + 1 or not np.all(np.isfinite(values)):
            raise InputError(f"{path}:{number}", f"{row}", f"{n + 1} finite numbers")
        rows.append(values)
    data = np.asarray(rows)
    if data.ndim != 2 or data.shape[0] < 2 or np.any(np.diff(data[:, 0]) <= 0):
        raise InputError(str(path), "times do not rise", "two or more rows of rising time")
    _refuse_extremes(data[:, 0], data[:, 1:], str(path))
    spline = CubicSpline(data[:, 0], data[:, 1:], bc_type="clamped")
    coef = np.zeros((data.shape[0] - 1, n, 6))
    coef[:, :, :4] = np.moveaxis(spline.c[::-1], 0, 2)
    return data[:, 0].copy(), coef


def _refuse_extremes(times: F64, poses: F64, where: str) -> None:
    """Refuse moments too close together, and numbers too large, for a polynomial between them."""
    if (least := float(np.diff(times).min())) < _LEAST_S:
        raise InputError(where, f"two times {least:g} s apart", f"{_LEAST_S:g} s or more")
    if (most := float(max(np.abs(times).max(), np.abs(poses).max()))) > _LARGEST:
        raise InputError(where, f"found {most:g}", f"times and positions up to {_LARGEST:g}")


def _harmonics(terms: list[list[tuple[float, float, float]]], offset: list[float]) -> Any:
    def build(table: ReferenceTable, home: F64) -> tuple[F64, ...]:
        if home.shape[0] != 2:
            raise InputError(
                "reference.kind", f"'{table.kind}' on {home.shape[0]} joints", "a robot with 2"
            )
        array = np.asarray(terms, dtype=np.float64)
        return (
            np.asarray(offset),
            *(np.ascontiguousarray(array[:, :, c]) for c in range(3)),
        )

    return build


_QUARTER = np.pi / 2
_BUILDERS: dict[str, Any] = {
    "hold": _hold,
    "sine": _sine,
    "multisine": _multisine,
    "waypoints": _waypoints,
    "csv": _csv,
    # (amplitude, angular frequency, phase) of each sine; Source: [zhao2017] section 5.
    "paper1": _harmonics([[(0.0, 1.0, 0.0)], [(1.0, 1.0, 0.0)]], [1.0, 0.0]),
    "paper2": _harmonics(
        [[(0.5, 1.0, _QUARTER), (0.2, 3.0, 0.0)], [(0.3, 3.0, _QUARTER), (-0.5, 2.0, 0.0)]],
        [0.0, 0.0],
    ),
}
