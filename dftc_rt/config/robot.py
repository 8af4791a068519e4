"""What ``robots/<name>/robot.toml`` may say, and where these files are.

Units are in the names. Everything that a URDF can know (masses, limits) is read from
the URDF; the file adds what it cannot know: the drives, the buses and a home.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

import msgspec

from dftc_rt.config import toml
from dftc_rt.errors import InputError, MissingFileError

Profile = Literal["cia402", "moteus", "mit"]
Plant = Literal["pendulums", "pendulums_physical", "arm2"]
"""Plants whose equations of motion are written down, and not derived from a URDF."""

COUNTS_PER_REV: Final = 524_288
"""Default encoder resolution: 19 bits."""

ARMATURE_KG_M2: Final = 0.05
"""Default armature of a joint with a torque limit of ``ARMATURE_TORQUE_NM`` or more; below,
in proportion to the torque limit: rotor inertia behind the gear grows with the drive."""

ARMATURE_TORQUE_NM: Final = 50.0

MOST_DELAY_CYCLES: Final = 1000
MOST_GRAVITY: Final = 1000.0
RANGES: Final = {
    "zero_offset_rad": (-1e4, 1e4),
    "counts_per_rev": (1, 2**31 - 1),
    "gear": (1e-4, 1e5),
    "rated_torque_nm": (1e-3, 1e6),
    "torque_limit_nm": (1e-3, 1e6),
    "velocity_limit_rad_s": (1e-3, math.inf),
    "armature": (0.0, 1e6),
}
"""Key of a joint -> what a drive's objects and the laws' arithmetic have room for."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")


class JointEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One ``[[joint]]`` as in the file; what is left out follows from the URDF.

    Attributes:
        name: Joint name in the URDF.
        node_id: 1 to 127; None: the joint's place in the robot, from 1.
        bus: Logical bus.
        sign: +1 when the drive turns as the URDF joint does, else -1.
        zero_offset_rad: Joint angle at the drive's zero.
        counts_per_rev: Encoder counts per turn of the encoder's shaft.
        gear: Turns of the encoder's shaft per turn of the joint.
        rated_torque_nm: Unit of the drive's per-mille torque; None: a third of the limit.
        torque_limit_nm: None: the URDF's effort limit.
        velocity_limit_rad_s: None: the URDF's velocity limit.
        armature: Rotor inertia seen at the joint, kg m^2 (kg for a prismatic joint);
            None: the rule at :data:`ARMATURE_KG_M2`.
        delay_cycles: Cycles from a command to its effect.
    """

    name: str
    node_id: int | None = None
    bus: str = "can0"
    sign: int = 1
    zero_offset_rad: float = 0.0
    counts_per_rev: int = COUNTS_PER_REV
    gear: float = 1.0
    rated_torque_nm: float | None = None
    torque_limit_nm: float | None = None
    velocity_limit_rad_s: float | None = None
    armature: float | None = None
    delay_cycles: int = 1

    def __post_init__(self) -> None:
        if self.node_id is not None and not 1 <= self.node_id <= 127:
            raise InputError("node_id", f"found {self.node_id}", "1 to 127")
        if not _NAME.fullmatch(self.bus):
            raise InputError("bus", f"found '{self.bus}'", "a bus name such as can0")
        if self.sign not in (1, -1):
            raise InputError("sign", f"found {self.sign}", "1 or -1")
        if not 0 <= self.delay_cycles <= MOST_DELAY_CYCLES:
            expected = f"0 to {MOST_DELAY_CYCLES}"
            raise InputError("delay_cycles", f"found {self.delay_cycles}", expected)
        if not math.isfinite(self.zero_offset_rad):
            raise InputError("zero_offset_rad", f"found {self.zero_offset_rad}", "a finite number")
        if self.armature is not None and not 0.0 <= self.armature < math.inf:
            raise InputError("armature", f"found {self.armature}", "0 or more, finite")
        for key in ("counts_per_rev", "gear", "rated_torque_nm", "torque_limit_nm",
                    "velocity_limit_rad_s"):  # fmt: skip
            value = getattr(self, key)
            if value is not None and not 0.0 < value < math.inf:
                raise InputError(key, f"found {value}", "more than 0, finite")


class JointConfig(msgspec.Struct, frozen=True, kw_only=True):
    """One joint with everything resolved; the attributes are those of :class:`JointEntry`."""

    name: str
    node_id: int
    bus: str
    sign: int
    zero_offset_rad: float
    counts_per_rev: int
    gear: float
    rated_torque_nm: float
    torque_limit_nm: float
    velocity_limit_rad_s: float
    armature: float
    delay_cycles: int


class RobotConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``robot.toml``.

    Attributes:
        name: Name of the robot, equal to its folder's.
        description: One line.
        urdf: Path relative to ``robot.toml``, or below ``example-robot-data/robots``.
        plant: Equations of motion that replace the URDF's on both sides of the wire; None:
            the URDF's.
        lock: Joints held fixed.
        lock_rad: Angle of each of them; None: 0, or what is within limits nearest to it.
        home_rad: One angle per joint that is not locked; None: see ``load_robot``.
        gravity_m_s2: Gravity in the base frame.
        profile: Drive profile.
        gains: Gains of the control law; the law checks the keys.
        joint: All joints that are not locked, in the model's order; or none of them, for
            the defaults of :func:`default_joints`.
    """

    name: str
    urdf: str
    description: str = ""
    plant: Plant | None = None
    lock: tuple[str, ...] = ()
    lock_rad: tuple[float, ...] | None = None
    home_rad: tuple[float, ...] | None = None
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -9.81)
    profile: Profile = "cia402"
    gains: dict[str, float | tuple[float, ...]] = {}
    joint: tuple[JointEntry, ...] = ()

    def __post_init__(self) -> None:
        if self.lock_rad is not None and len(self.lock_rad) != len(self.lock):
            raise InputError(
                "lock_rad", f"found {len(self.lock_rad)} numbers", f"{len(self.lock)}, as in lock"
            )
        for g in self.gravity_m_s2:
            if not abs(g) <= MOST_GRAVITY:
                raise InputError("gravity_m_s2", f"found {g:g}", f"at most {MOST_GRAVITY:g}")
        names: dict[str, int] = {}
        nodes: dict[tuple[str, int], int] = {}
        for index, joint in enumerate(self.joint):
            node = (joint.bus, index + 1 if joint.node_id is None else joint.node_id)
            if joint.name in names:
                raise InputError(
                    f"joint[{index}].name",
                    f"'{joint.name}' is also joint[{names[joint.name]}]",
                    "each joint once",
                )
            if node in nodes:
                raise InputError(
                    f"joint[{index}].node_id",
                    f"node {node[1]} on {node[0]} is also joint[{nodes[node]}]",
                    "each node once on its bus",
                )
            names[joint.name] = nodes[node] = index


def default_armature(torque_limit: float) -> float:
    """Armature that is assumed for a drive of this torque limit (Nm), kg m^2."""
    return ARMATURE_KG_M2 * min(1.0, torque_limit / ARMATURE_TORQUE_NM)


def default_joints(
    names: Sequence[str],
    torque_limits: Sequence[float],
    joints_per_bus: int = 3,
    velocity_limits: Sequence[float] | None = None,
) -> tuple[JointConfig, ...]:
    """Drives of a robot that is only a URDF.

    Node ids 1, 2, ... in joint order; as few buses as ``joints_per_bus`` allows, filled
    evenly (7 joints: 3 + 2 + 2); rated torque a third of the limit; armature by
    :func:`default_armature`.

    Args:
        names: Joint names, in the model's order.
        torque_limits: (n,) Nm.
        joints_per_bus: Most joints of a bus; CiA 402 at 1 kHz and 1 Mbit/s fits 3.
        velocity_limits: (n,) rad/s; None: unlimited.
    """
    n = len(names)
    velocities = [math.inf] * n if velocity_limits is None else velocity_limits
    buses = _evenly(n, joints_per_bus)
    return tuple(
        resolve_joint(JointEntry(name=name, bus=bus), index + 1, limit, velocity)
        for index, (name, limit, velocity, bus) in enumerate(
            zip(names, torque_limits, velocities, buses, strict=True)
        )
    )


def on_new_buses(joints: Sequence[JointConfig], joints_per_bus: int) -> tuple[JointConfig, ...]:
    """Return the drives wired anew: as few buses as ``joints_per_bus`` allows, filled evenly.

    Raises:
        InputError: Two drives that come to share a bus have the same node id.
    """
    buses = _evenly(len(joints), joints_per_bus)
    wired = tuple(
        msgspec.structs.replace(joint, bus=bus) for joint, bus in zip(joints, buses, strict=True)
    )
    taken: dict[tuple[str, int], str] = {}
    for joint in wired:
        other = taken.setdefault((joint.bus, joint.node_id), joint.name)
        if other != joint.name:
            what = f"{other} and {joint.name} would share node id {joint.node_id} on {joint.bus}"
            raise InputError("robot.joints_per_bus", what)
    return wired


def _evenly(n: int, joints_per_bus: int) -> list[str]:
    """Return the bus of each of n joints: can0, can1, …, as few as will do."""
    if joints_per_bus < 1:
        raise InputError("joints_per_bus", f"found {joints_per_bus}", "1 or more")
    buses = -(-n // joints_per_bus)
    small, larger = divmod(n, buses) if buses else (0, 0)
    return [f"can{bus}" for bus in range(buses) for _ in range(small + (bus < larger))]


def resolve_joint(
    entry: JointEntry, place: int, torque_limit: float, velocity_limit: float
) -> JointConfig:
    """Fill in what a ``[[joint]]`` leaves out.

    Args:
        entry: As in the file.
        place: The joint's place in the robot, from 1.
        torque_limit: The URDF's, Nm.
        velocity_limit: The URDF's, rad/s.
    """
    limit = torque_limit if entry.torque_limit_nm is None else entry.torque_limit_nm
    velocity = entry.velocity_limit_rad_s
    return JointConfig(
        name=entry.name,
        node_id=place if entry.node_id is None else entry.node_id,
        bus=entry.bus,
        sign=entry.sign,
        zero_offset_rad=entry.zero_offset_rad,
        counts_per_rev=entry.counts_per_rev,
        gear=entry.gear,
        rated_torque_nm=limit / 3.0 if entry.rated_torque_nm is None else entry.rated_torque_nm,
        torque_limit_nm=limit,
        velocity_limit_rad_s=velocity_limit if velocity is None else velocity,
        armature=default_armature(limit) if entry.armature is None else entry.armature,
        delay_cycles=entry.delay_cycles,
    )


def one_robot(name: object, urdf: object, plant: object, where: str) -> None:
    """Refuse a robot that is given in no way, or in more ways than one.

    Args:
        name: ``robot.name``; None: not given.
        urdf: ``robot.urdf``.
        plant: ``robot.plant``.
        where: For the message.

    Raises:
        InputError: Not exactly one of them is given.
    """
    given = [key for key, v in (("name", name), ("urdf", urdf), ("plant", plant)) if v is not None]
    if len(given) != 1:
        found = " and ".join(given) if given else "none of them"
        raise InputError(where, f"found {found}", "one of name, urdf, plant")


def robots_dir() -> Path:
    """Folder of the robots: ``robots/`` of a checkout, else the one inside the wheel."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "_robots"
    return installed if installed.is_dir() else package.parent / "robots"


def robot_names() -> tuple[str, ...]:
    """Names of the robots that can be given as ``robot.name``, sorted."""
    return tuple(sorted(path.parent.name for path in robots_dir().glob("*/robot.toml")))


def load_robot_config(name: str) -> tuple[RobotConfig, Path]:
    """Read ``robots/<name>/robot.toml``.

    Returns:
        What it says, and its path.

    Raises:
        InputError: No such robot (the message lists them), or a wrong file.
    """
    available = ", ".join(robot_names())
    path = robots_dir() / name / "robot.toml"
    if not _NAME.fullmatch(name):
        raise InputError("robot.name", f"'{name}' is no robot name", f"one of {available}")
    if not path.is_file():
        raise MissingFileError("robot.name", f"no robot '{name}'", f"one of {available}")
    config = toml.load(path, RobotConfig)
    if config.name != name:
        raise InputError(f"{path}: name", f"found '{config.name}'", f"'{name}', as its folder")
    return config, path
