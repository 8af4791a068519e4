"""A robot: its Pinocchio model, limits, home and drives, in scalar joint coordinates.

Everywhere outside of this package a position is ``q`` of shape (n,): one angle (rad), or
length (m) of a prismatic joint, per joint. Pinocchio stores a continuous joint as
(cos, sin); :meth:`Robot.configuration` is the way there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dftc_rt.config.robot import JointConfig, Profile, RobotConfig
from dftc_rt.dynamics.closed_form.plants import ClosedForm
from dftc_rt.dynamics.friction import Friction
from dftc_rt.dynamics.urdf import Urdf
from dftc_rt.errors import InputError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Robot:
    """A fixed-base robot of n scalar joints. Arrays are read-only.

    Attributes:
        name: Name of the robot.
        description: One line.
        model: ``pin.Model``: locked joints removed, armature and gravity set.
        joints: Joint names, in the model's order.
        lower: (n,) rad (m); -inf where there is no limit.
        upper: (n,) rad (m); inf where there is no limit.
        velocity_limit: (n,) rad/s (m/s); inf where none is stated.
        torque_limit: (n,) Nm (N).
        torque_limit_assumed: (n,) bool: neither the URDF nor ``robot.toml`` states a limit,
            so ``torque_limit`` is that of :mod:`dftc_rt.dynamics.limits`.
        home: (n,) rad (m).
        continuous: (n,) bool: turns without end; nq = 2 in Pinocchio.
        prismatic: (n,) bool.
        gravity: (3,) m/s^2 in the base frame.
        joint_config: Drive of each joint.
        profile: Drive profile.
        gains: Gains from ``robot.toml``.
        locked: Joints that are held fixed, and where, rad (m).
        urdf: The URDF: path, text, all joints.
        config: What ``robot.toml`` says; of a bare URDF, its name and path alone.
        friction: Friction from a calibration; None: none is assumed.
        torque_constant: (n,) true over nominal torque constant, from a calibration; None: 1.
        package_dirs: Where ``package://`` meshes are found.
        closed_form: Equations of motion that hold instead of the model's; ``model`` is its
            geometry then. None: those of ``model``. :mod:`dftc_rt.dynamics.select` chooses.
    """

    name: str
    description: str
    model: Any
    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity_limit: Array
    torque_limit: Array
    torque_limit_assumed: npt.NDArray[np.bool_]
    home: Array
    continuous: npt.NDArray[np.bool_]
    prismatic: npt.NDArray[np.bool_]
    gravity: Array
    joint_config: tuple[JointConfig, ...]
    profile: Profile
    gains: dict[str, float | tuple[float, ...]]
    locked: dict[str, float]
    urdf: Urdf
    config: RobotConfig
    package_dirs: tuple[Path, ...]
    closed_form: ClosedForm | None
    idx_q: tuple[int, ...] = field(repr=False)
    friction: Friction | None = None
    torque_constant: tuple[float, ...] | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def urdf_xml(self) -> str:
        """Text of the URDF, as ``/robot_description`` carries it."""
        return self.urdf.xml

    @property
    def urdf_path(self) -> Path:
        """Path of the URDF."""
        return self.urdf.path

    @property
    def armature(self) -> Array:
        """(n,) rotor inertia in the model, kg m^2 (kg)."""
        return np.array(self.model.armature, dtype=np.float64)

    def configuration(self, q: Array, out: Array | None = None) -> Array:
        """Map joint coordinates to Pinocchio's configuration vector.

        Args:
            q: (n,) rad (m).
            out: (nq,) to write into; None: a new array.

        Returns:
            (nq,); ``q`` itself, not a copy, when the robot has no continuous joint.
        """
        if self.model.nq == self.model.nv:
            return q
        if out is None:
            out = np.empty(self.model.nq)
        for i, k in enumerate(self.idx_q):
            if self.continuous[i]:
                out[k] = math.cos(q[i])
                out[k + 1] = math.sin(q[i])
            else:
                out[k] = q[i]
        return out

    def joint_index(self, name: str) -> int:
        """Index of a joint.

        Raises:
            InputError: The robot has no such joint, or holds it fixed.
        """
        if name in self.joints:
            return self.joints.index(name)
        what = "is locked" if name in self.locked else "is no joint of the robot"
        raise InputError(f"joint '{name}'", what, "one of " + ", ".join(self.joints))
