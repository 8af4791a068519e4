"""What a moteus drive's numbers are worth at the joint.

Position, velocity and torque are those of the output shaft, in revolutions and Nm: the drive
is told its gear by its own configuration.

Source: [moteus], "Register Reference".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.robot import JointConfig
from dftc_rt.config.scenario import MoteusTable
from dftc_rt.drives.data_sheet import data_sheets, scales_as
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.moteus import codec
from dftc_rt.drives.polled_scale import PolledScale, refuse_host_id
from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]

TORQUE_STEP: Final = 0.01  # Nm, of an int16
TIMEOUT_STEP: Final = 0.01  # s, of an int8
_MOST: Final = 32767 * TORQUE_STEP
_TOLERANCE: Final = 1 + 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class MoteusScale(PolledScale):
    """One joint's moteus drive: its data sheet, and how it is commanded.

    Attributes:
        timeout: Watchdog that commands carry, 0.01 s; 0: as the drive is set.
    """

    timeout: int = 0

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            InputError: A value is out of what the drive can be told.
        """
        if not TORQUE_STEP <= self.max_torque_nm <= _MOST:
            raise InputError(
                f"{self.joint}.torque_limit_nm",
                f"{self.max_torque_nm:g} Nm with bus.profile 'moteus'",
                f"{TORQUE_STEP:g} to {_MOST:g} Nm",
            )
        JointScale.__post_init__(self)

    @property
    def torque_per_count(self) -> float:
        """True torque of one count, Nm (N)."""
        return TORQUE_STEP * self.torque_constant

    @property
    def max_counts(self) -> int:
        """Largest torque that may be commanded, 0.01 Nm, rounded towards zero."""
        return math.floor(self.max_torque_nm / TORQUE_STEP * _TOLERANCE)


def moteus_scales(
    joints: Sequence[JointConfig],
    table: MoteusTable,
    lower: F64,
    upper: F64,
    torque_constant: Sequence[float] | None = None,
) -> list[MoteusScale]:
    """Return the drives of a robot, in joint order.

    Args:
        joints: The joints.
        table: ``[bus.moteus]``.
        lower: Lower position limits, (n,), rad (m).
        upper: Upper position limits, (n,), rad (m).
        torque_constant: True over nominal, (n,), from a calibration; None: 1.

    Raises:
        InputError: A value does not fit the robot.
    """
    timeout = round(table.watchdog_s / TIMEOUT_STEP)
    if not math.isclose(timeout, table.watchdog_s / TIMEOUT_STEP, abs_tol=1e-9):
        what = f"{table.watchdog_s:g} s"
        raise InputError("bus.moteus.watchdog_s", what, "a whole number of 0.01 s")
    refuse_host_id("bus.moteus.host_id", table.host_id, joints)
    return [
        MoteusScale(
            **sheet,
            lower=float(lower[i]),
            upper=float(upper[i]),
            host_id=table.host_id,
            timeout=timeout,
        )
        for i, sheet in enumerate(data_sheets(joints, torque_constant))
    ]


def scales_of(drives: Sequence[DriveConfig]) -> list[MoteusScale]:
    """Return the scales of some drives, in their order.

    Raises:
        InputError: A drive has none: it was described for another profile.
    """
    return scales_as(drives, MoteusScale, "no scale of a moteus drive")


def wire_table(scales: Sequence[MoteusScale]) -> F64:
    """Return the scales as one matrix for the kernels, (codec.WIRE_ROWS, n)."""
    table = np.empty((codec.WIRE_ROWS, len(scales)))
    for i, s in enumerate(scales):
        table[:, i] = s.sign, s.zero_offset_rad, s.torque_constant
    return table
