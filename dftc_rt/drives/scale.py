"""Scale table: what one count of a drive is worth at the joint.

    q   = sign · rad_per_count · counts − zero_offset          (rad; m on a prismatic joint)
    v   = sign · rad_per_count · counts_per_second             (rad/s)
    τ   = sign · torque_per_count · per_mille                  (Nm; N on a prismatic joint)

with ``rad_per_count = 2π / (counts_per_rev · gear)`` and
``torque_per_count = rated_torque / 1000``. Rated torque is given behind the gear, at the
joint, so gear ratio and efficiency do not enter the torque a second time. ``zero_offset``
is what the encoder shows, in joint units, when the joint is at q = 0.

Positions travel as int32 and wrap; :func:`unwrap` carries them on in 64 bits.

Source: CiA 402-2, objects 6064h, 606Ch, 6071h, 6076h, 6077h, 608Fh, 6091h.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import ClassVar, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.errors import InputError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Rows of ScaleTable.values.
RAD_PER_COUNT: Final = 0  # signed, rad (m)
ZERO_OFFSET: Final = 1  # rad (m)
TORQUE_PER_COUNT: Final = 2  # signed, Nm (N)
MAX_COUNTS: Final = 3  # largest |6071h| that may be commanded, per mille of rated
ROWS: Final = 4

_INT16_MAX = 32767
_POSITIVE = (
    "counts_per_rev", "gear", "rated_torque_nm", "max_torque_nm", "torque_constant",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class JointScale:
    """One joint's drive as its data sheet gives it.

    Attributes:
        joint: Joint name.
        counts_per_rev: Encoder counts per motor revolution (608Fh).
        gear: Motor revolutions per joint revolution (6091h).
        sign: +1, or −1 when the motor turns against the joint.
        zero_offset_rad: Encoder reading, in joint units, at q = 0, rad.
        rated_torque_nm: Rated torque at the joint, Nm (6076h, there in mNm).
        max_torque_nm: Largest torque to be commanded, Nm (6072h).
        torque_constant: True over nominal torque constant, from a calibration: a command of
            the nominal torque delivers this much of it. The drive's own objects stay nominal.
        every_count: Whether each whole count can be commanded; if not, odd ones alone.
    """

    every_count: ClassVar[bool] = True

    joint: str
    counts_per_rev: int
    rated_torque_nm: float
    max_torque_nm: float
    gear: float = 1.0
    sign: int = 1
    zero_offset_rad: float = 0.0
    torque_constant: float = 1.0

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            InputError: A value is out of its range.
        """
        for name in _POSITIVE:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{self.joint}.{name}", repr(value), "a number above 0")
        if self.sign not in (-1, 1):
            raise InputError(f"{self.joint}.sign", repr(self.sign), "1 or -1")
        if not math.isfinite(self.zero_offset_rad):
            raise InputError(f"{self.joint}.zero_offset_rad", repr(self.zero_offset_rad))
        if self.max_counts > _INT16_MAX or self.max_counts < 1:
            raise InputError(
                f"{self.joint}.max_torque_nm",
                f"{self.max_torque_nm} Nm is {self.max_counts} per mille of rated torque",
                f"1 to {_INT16_MAX}",
            )

    @property
    def torque_per_count(self) -> float:
        """True torque of one count, Nm (N)."""
        return self.rated_torque_nm * self.torque_constant / 1000.0

    @property
    def max_counts(self) -> int:
        """Largest target torque, per mille of rated, rounded towards zero."""
        return math.floor(1000.0 * self.max_torque_nm / self.rated_torque_nm * (1 + 1e-12))

    @property
    def rated_torque_mnm(self) -> int:
        """Object 6076h, mNm."""
        return round(1000.0 * self.rated_torque_nm)

    @property
    def gear_ratio(self) -> tuple[int, int]:
        """Object 6091h: (motor revolutions, shaft revolutions)."""
        ratio = Fraction(self.gear).limit_denominator(100_000)
        return ratio.numerator, ratio.denominator


@dataclass(frozen=True, slots=True)
class ScaleTable:
    """Scales of n joints as one matrix for the kernels.

    Attributes:
        values: (ROWS, n), float64, rows named at the top of this module.
    """

    values: F64

    @classmethod
    def of(cls, joints: Sequence[JointScale]) -> ScaleTable:
        """Return the table of some joints, in their order."""
        values = np.empty((ROWS, len(joints)))
        for i, joint in enumerate(joints):
            values[RAD_PER_COUNT, i] = joint.sign * math.tau / (joint.counts_per_rev * joint.gear)
            values[ZERO_OFFSET, i] = joint.zero_offset_rad
            values[TORQUE_PER_COUNT, i] = joint.sign * joint.torque_per_count
            values[MAX_COUNTS, i] = joint.max_counts
        return cls(values)

    def position(self, counts: I64) -> F64:
        """Return joint positions, (n,), rad, of unwrapped counts (6064h)."""
        q: F64 = self.values[RAD_PER_COUNT] * counts - self.values[ZERO_OFFSET]
        return q

    def velocity(self, counts_per_s: I64) -> F64:
        """Return joint velocities, (n,), rad/s, of counts per second (606Ch)."""
        v: F64 = self.values[RAD_PER_COUNT] * counts_per_s
        return v

    def torque(self, per_mille: I64) -> F64:
        """Return joint torques, (n,), Nm, of per mille of rated (6071h, 6077h)."""
        tau: F64 = self.values[TORQUE_PER_COUNT] * per_mille
        return tau

    def position_counts(self, q: F64) -> I64:
        """Return what encoders show at joint positions, (n,), rad, before int32 wraps it."""
        counts = np.rint((q + self.values[ZERO_OFFSET]) / self.values[RAD_PER_COUNT])
        return np.asarray(counts, dtype=np.int64)


def torque_grid(scales: Sequence[JointScale], limit: F64) -> tuple[F64, F64]:
    """Return what a law must know of the torques that the drives can be told.

    Args:
        scales: The drives, in joint order.
        limit: Largest torque of each joint, (n,), Nm.

    Returns:
        Steps that a law may round to, (n,), Nm, 0 where a drive has no code for zero and so
        rounds by itself; and the largest torque that can be commanded, (n,), Nm.
    """
    values = ScaleTable.of(scales).values
    step = np.abs(values[TORQUE_PER_COUNT])
    counts = np.minimum(np.floor(limit / step * (1 + 1e-12)), values[MAX_COUNTS])
    every = np.array([scale.every_count for scale in scales])
    counts = np.where(every, counts, counts - (counts + 1.0) % 2.0)
    return np.where(every, step, 0.0), counts * step


@njit(cache=True)
def unwrap(previous: int, raw: int) -> int:
    """Carry a wrapped int32 on from the last unwrapped value.

    Right as long as the joint moves less than 2^31 counts between the two.
    """
    delta = (raw - previous) & 0xFFFFFFFF
    if delta >= 0x80000000:
        delta -= 0x100000000
    return previous + delta


@njit(cache=True)
def quantise_torque(tau: F64, scale: F64, counts: I64, sent: F64) -> None:
    """Turn torques into counts, limited to what may be commanded, and back.

    A torque that is no number becomes zero counts.

    Args:
        tau: Wanted torques, (n,), Nm.
        scale: ``ScaleTable.values``, (ROWS, n).
        counts: Filled with per mille of rated, (n,).
        sent: Filled with the torque that those counts mean, (n,), Nm.
    """
    for i in range(tau.shape[0]):
        wanted = tau[i] / scale[TORQUE_PER_COUNT, i]
        limit = scale[MAX_COUNTS, i]
        if not math.isfinite(wanted):
            wanted = 0.0 if math.isnan(wanted) else math.copysign(limit, wanted)
        limited = min(max(wanted, -limit), limit)
        whole = np.int64(np.rint(limited))
        counts[i] = whole
        sent[i] = whole * scale[TORQUE_PER_COUNT, i]
