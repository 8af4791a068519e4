"""What a robot file says of a joint's drive, as the scales of every profile begin with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from dftc_rt.config.robot import JointConfig
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import InputError

S = TypeVar("S", bound=JointScale)


def data_sheet(joint: JointConfig, torque_constant: float) -> dict[str, Any]:
    """Return the arguments of :class:`JointScale` for a joint.

    Args:
        joint: The joint.
        torque_constant: True over nominal, from a calibration.
    """
    return {
        "joint": joint.name,
        "counts_per_rev": joint.counts_per_rev,
        "rated_torque_nm": joint.rated_torque_nm,
        "max_torque_nm": joint.torque_limit_nm,
        "gear": joint.gear,
        "sign": joint.sign,
        "zero_offset_rad": joint.zero_offset_rad,
        "torque_constant": torque_constant,
    }


def data_sheets(
    joints: Sequence[JointConfig], torque_constant: Sequence[float] | None
) -> list[dict[str, Any]]:
    """Return :func:`data_sheet` of every joint.

    Args:
        joints: The joints.
        torque_constant: True over nominal, (n,), from a calibration; None: 1.
    """
    constants = [1.0] * len(joints) if torque_constant is None else torque_constant
    return [data_sheet(j, constant) for j, constant in zip(joints, constants, strict=True)]


def scales_as(drives: Sequence[DriveConfig], kind: type[S], lacks: str) -> list[S]:
    """Return the scales of some drives, in their order, as those of one profile.

    Args:
        drives: The drives.
        kind: Scale of the profile.
        lacks: What a drive lacks whose scale is of another one.

    Raises:
        InputError: A drive was described for another profile.
    """
    found = []
    for drive in drives:
        if not isinstance(drive.scale, kind):
            raise InputError(drive.scale.joint, lacks)
        found.append(drive.scale)
    return found
