"""From a robot's joints to its drives: which bus, which node, which scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import FD_FRAME_SIZE, FRAME_SIZE
from dftc_rt.config.robot import JointConfig
from dftc_rt.config.scenario import BusTable
from dftc_rt.drives.data_sheet import data_sheets
from dftc_rt.drives.interface import DriveConfig, profile
from dftc_rt.drives.mit.scale import mit_scales
from dftc_rt.drives.moteus.scale import moteus_scales
from dftc_rt.drives.scale import JointScale

F64 = NDArray[np.float64]


class Wired(Protocol):
    """What of a robot its drives follow from."""

    @property
    def joint_config(self) -> tuple[JointConfig, ...]:
        """Drive of each joint, as the robot file has it."""
        ...

    @property
    def lower(self) -> F64:
        """Lower position limits, (n,), rad (m)."""
        ...

    @property
    def upper(self) -> F64:
        """Upper position limits, (n,), rad (m)."""
        ...

    @property
    def torque_constant(self) -> tuple[float, ...] | None:
        """True over nominal torque constant, (n,); None: 1."""
        ...


def robot_drives(robot: Wired, bus: BusTable) -> list[DriveConfig]:
    """Return the drives of a robot as the profile of ``[bus]`` needs them, in joint order.

    Args:
        robot: The robot.
        bus: The scenario's ``[bus]``.

    Raises:
        InputError: A value is out of what the drive can express.
    """
    joints, constant = robot.joint_config, robot.torque_constant
    if bus.profile == "mit":
        return _wire(joints, mit_scales(joints, bus.mit, robot.lower, robot.upper, constant))
    if bus.profile == "moteus":
        moteus = moteus_scales(joints, bus.moteus, robot.lower, robot.upper, constant)
        return _wire(joints, moteus)
    return drive_configs(joints, constant)


def joint_scales(
    joints: Sequence[JointConfig], torque_constant: Sequence[float] | None = None
) -> list[JointScale]:
    """Return the data sheets of the drives, in joint order.

    Args:
        joints: The joints.
        torque_constant: True over nominal, (n,), from a calibration; None: 1.

    Raises:
        InputError: A value is out of what the drive can express.
    """
    return [JointScale(**sheet) for sheet in data_sheets(joints, torque_constant)]


def drive_configs(
    joints: Sequence[JointConfig], torque_constant: Sequence[float] | None = None
) -> list[DriveConfig]:
    """Return the drives, in joint order, with their buses by index.

    Args:
        joints: The joints.
        torque_constant: As of :func:`joint_scales`.

    Raises:
        InputError: A value is out of what the drive can express.
    """
    return _wire(joints, joint_scales(joints, torque_constant))


def _wire(joints: Sequence[JointConfig], scales: Sequence[JointScale]) -> list[DriveConfig]:
    """Put each drive on its bus."""
    names = bus_names(joints)
    return [
        DriveConfig(j.node_id, names.index(j.bus), scale)
        for j, scale in zip(joints, scales, strict=True)
    ]


def fd_bitrate(bus: BusTable) -> int | None:
    """Return the bit rate of the data of CAN FD frames; None on classical buses."""
    return bus.data_bitrate if profile(bus.profile).fd else None


def frame_size(bus: BusTable) -> int:
    """Return the bytes of a row of every frame buffer: 16, or 72 where frames are CAN FD."""
    return FRAME_SIZE if fd_bitrate(bus) is None else FD_FRAME_SIZE


def bus_names(joints: Sequence[JointConfig]) -> list[str]:
    """Return the logical buses, in the order in which the joints name them."""
    return list(dict.fromkeys(j.bus for j in joints))


def bus_members(joints: Sequence[JointConfig], bus: str) -> NDArray[np.int64]:
    """Return the indices of the joints on one bus, (m,)."""
    return np.array([i for i, j in enumerate(joints) if j.bus == bus], dtype=np.int64)
