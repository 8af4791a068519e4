"""Ranges of an MIT drive on the wire, and what they are when nobody says.

Every quantity travels as an unsigned number that spans a range both ends must agree on:
±p_max in 16 bits, ±v_max and ±t_max in 12. The protocol has no way to ask a drive for its
ranges, so that a wrong one shows as a wrong scale, never as an error.

An even number of codes spans a range that is even about zero, so that no code means zero:
a torque is an odd number of half steps, ``t_max / 4095`` each. "Zero" is sent as half a
step below zero.

Source: [katz2018]; ``CAN_com.cpp`` of its firmware.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.robot import JointConfig
from dftc_rt.config.scenario import MitTable
from dftc_rt.drives.data_sheet import data_sheets, scales_as
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.polled_scale import PolledScale, refuse_host_id
from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]

T_CODES: Final = 4095  # largest code of 12 bits

# Rows of wire_table.
P_MAX: Final = 0  # rad (m)
V_MAX: Final = 1  # rad/s (m/s)
T_MAX: Final = 2  # Nm (N), nominal
KP_MAX: Final = 3  # Nm/rad
KD_MAX: Final = 4  # Nm s/rad
SIGN: Final = 5  # 1 or -1: the drive's direction against the joint's
ZERO: Final = 6  # what the drive shows, in joint units, at q = 0, rad (m)
TORQUE_CONSTANT: Final = 7  # true over nominal
WRAPS: Final = 8  # 1: positions beyond ±p_max wrap; 0: they stick to the end
ROWS: Final = 9

_UNLIMITED_P: Final = 12.5  # as the firmware is published; ranges of joints without limits
_UNLIMITED_V: Final = 45.0
_P_MARGIN: Final = 1.05  # default range over what the joint's limits need
_V_MARGIN: Final = 1.5  # a velocity that leaves its range sticks to its end: allow for overshoot
_TOLERANCE: Final = 1 + 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class MitScale(PolledScale):
    """One joint's MIT drive: its data sheet and its ranges on the wire.

    Torque counts are half steps, of which only the odd ones exist.

    Attributes:
        p_max: Position range, rad (m) at the joint.
        v_max: Velocity range, rad/s (m/s).
        t_max: Torque range, Nm (N).
        kp_max: Range of the position gain, Nm/rad; from 0.
        kd_max: Range of the velocity gain, Nm s/rad; from 0.
        answer_bytes: 6, or 8 with temperature and error; the emulated drives' only.
        wraps: Whether positions beyond ±p_max wrap, and do not stick to the end.
    """

    every_count: ClassVar[bool] = False

    p_max: float
    v_max: float
    t_max: float
    kp_max: float
    kd_max: float
    answer_bytes: int = 6
    wraps: bool = False

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            InputError: A range is no number above 0, or the joint does not fit it.
        """
        for name in ("p_max", "v_max", "t_max", "kp_max", "kd_max"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{self.joint}.{name}", repr(value), "a number above 0")
        if self.max_torque_nm > self.t_max * _TOLERANCE:
            raise InputError(
                "bus.mit.t_max_nm",
                f"{self.t_max:g} Nm for {self.joint}",
                f"its torque limit, {self.max_torque_nm:g} Nm, or more",
            )
        JointScale.__post_init__(self)
        reach = self.reach(self.lower, self.upper, self.zero_offset_rad)
        if math.isinf(reach) and not self.wraps:
            raise InputError(
                "bus.mit.position_wraps",
                f"{self.joint} turns without end, and its drive's position ends at ±p_max",
                "true, if the drive goes on from the other end there",
            )
        if math.isfinite(reach) and reach > self.p_max * _TOLERANCE:
            raise InputError(
                "bus.mit.p_max_rad",
                f"±{self.p_max:g} rad for {self.joint}",
                f"its whole range, up to ±{reach:.4g} rad at the drive",
            )

    @staticmethod
    def reach(lower: float, upper: float, zero_offset: float) -> float:
        """Return how far from its zero a drive gets within the joint's limits, rad (m)."""
        return max(abs(lower + zero_offset), abs(upper + zero_offset))

    @property
    def torque_per_count(self) -> float:
        """True torque of half a step, Nm."""
        return self.t_max * self.torque_constant / T_CODES

    @property
    def max_counts(self) -> int:
        """Most half steps that may be commanded: an odd number, rounded towards zero."""
        within = math.floor(T_CODES * self.max_torque_nm / self.t_max * _TOLERANCE)
        return min(within - (within + 1) % 2, T_CODES)


def mit_scales(
    joints: Sequence[JointConfig],
    table: MitTable,
    lower: F64,
    upper: F64,
    torque_constant: Sequence[float] | None = None,
) -> list[MitScale]:
    """Return the drives of a robot, in joint order; ranges left out follow from the limits.

    Args:
        joints: The joints.
        table: ``[bus.mit]``.
        lower: Lower position limits, (n,), rad (m).
        upper: Upper position limits, (n,), rad (m).
        torque_constant: True over nominal, (n,), from a calibration; None: 1.

    Raises:
        InputError: A value does not fit the robot.
    """
    n = len(joints)
    position, velocity, torque, kp, kd = (
        _per_joint(getattr(table, key), n, f"bus.mit.{key}")
        for key in ("p_max_rad", "v_max_rad_s", "t_max_nm", "kp_max", "kd_max")
    )
    refuse_host_id("bus.mit.host_id", table.host_id, joints)
    _refuse_collisions(table.host_id, joints)
    sheets = data_sheets(joints, torque_constant)
    scales = []
    for i, j in enumerate(joints):
        reach = MitScale.reach(float(lower[i]), float(upper[i]), j.zero_offset_rad)
        speed = j.velocity_limit_rad_s
        given_speed = velocity[i]
        if given_speed is not None and math.isfinite(speed) and given_speed < speed:
            raise InputError(
                "bus.mit.v_max_rad_s",
                f"{given_speed:g} rad/s for {j.name}",
                f"its velocity limit, {speed:g} rad/s, or more",
            )
        scales.append(
            MitScale(
                **sheets[i],
                p_max=_or(position[i], _or_unlimited(_P_MARGIN * reach, _UNLIMITED_P)),
                v_max=_or(given_speed, _or_unlimited(_V_MARGIN * speed, _UNLIMITED_V)),
                t_max=_or(torque[i], j.torque_limit_nm),
                kp_max=kp[i],
                kd_max=kd[i],
                lower=float(lower[i]),
                upper=float(upper[i]),
                host_id=table.host_id,
                answer_bytes=table.answer_bytes,
                wraps=table.position_wraps,
            )
        )
    return scales


def scales_of(drives: Sequence[DriveConfig]) -> list[MitScale]:
    """Return the ranges of some drives, in their order.

    Raises:
        InputError: A drive has none: it was described for another profile.
    """
    return scales_as(drives, MitScale, "no ranges of an MIT drive")


def wire_table(scales: Sequence[MitScale]) -> F64:
    """Return the ranges as one matrix for the kernels, (ROWS, n)."""
    table = np.empty((ROWS, len(scales)))
    for i, s in enumerate(scales):
        table[:, i] = (
            s.p_max, s.v_max, s.t_max, s.kp_max, s.kd_max,
            s.sign, s.zero_offset_rad, s.torque_constant, s.wraps,
        )  # fmt: skip
    return table


def _refuse_collisions(host_id: int, joints: Sequence[JointConfig]) -> None:
    """Refuse answers that yield to commands: several drives would send theirs at once.

    Raises:
        InputError: On a bus with several drives some command has priority over the answers,
            which have one identifier for all.
    """
    for bus in dict.fromkeys(joint.bus for joint in joints):
        there = [joint for joint in joints if joint.bus == bus]
        first = min(there, key=lambda joint: joint.node_id)
        if len(there) > 1 and host_id > first.node_id:
            raise InputError(
                "bus.mit.host_id",
                f"answers with identifier {host_id} yield to commands to {first.name}, node "
                f"{first.node_id}, so that the drives of {bus} would send theirs at once",
                f"less than {first.node_id}, or one drive a bus",
            )


def _per_joint(value: Any, n: int, where: str) -> Sequence[Any]:
    """Return one value per joint.

    Raises:
        InputError: There are more or fewer than joints.
    """
    if isinstance(value, tuple):
        if len(value) != n:
            raise InputError(where, f"{len(value)} values", f"one, or {n}, one per joint")
        return value
    return [value] * n


def _or(value: float | None, default: float) -> float:
    return default if value is None else value


def _or_unlimited(value: float, unlimited: float) -> float:
    return value if math.isfinite(value) else unlimited
