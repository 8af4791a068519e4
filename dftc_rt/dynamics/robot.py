"""Load a robot, by name, from a bare URDF or as a closed form, or say in one line why not."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dftc_rt.config.robot import (
    RANGES,
    JointConfig,
    RobotConfig,
    default_joints,
    load_robot_config,
    on_new_buses,
    one_robot,
    resolve_joint,
)
from dftc_rt.dynamics.closed_form.fit import check_fit, closed_form
from dftc_rt.dynamics.limits import JointLimits, joint_limits
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.urdf import check_urdf, find_urdf, package_dirs, parse_model, read_urdf
from dftc_rt.errors import InputError

__all__ = ["Robot", "load_robot"]

Array = npt.NDArray[np.float64]

_MIN_INERTIA = 1e-9  # kg m^2 (kg): below this a joint moves no mass
_MIN_EIGENVALUE = 1e-10  # of M scaled to a unit diagonal: below this M is singular
_ROUNDING = 1e-6  # of an inertia's greatest eigenvalue: files have few digits


def load_robot(
    name: str | None = None,
    urdf: str | Path | None = None,
    lock: Sequence[str] = (),
    lock_rad: Sequence[float] | None = None,
    home_rad: Sequence[float] | None = None,
    gravity_m_s2: Sequence[float] | None = None,
    plant: str | None = None,
    joints_per_bus: int | None = None,
    unstated_joints_per_bus: int = 3,
    stored: tuple[RobotConfig, str] | None = None,
) -> Robot:
    """Load a robot by name, from a bare URDF, or with the equations of a closed form.

    Args:
        name: A folder of ``robots/``; this, ``urdf`` or ``plant`` is needed.
        urdf: Path, or path below ``example-robot-data/robots``.
        lock: Joints held fixed, besides those that ``robot.toml`` locks.
        lock_rad: Where, one per entry of ``lock``; None: at the home of ``robot.toml``,
            else at 0, or mid-range where 0 is not within limits.
        home_rad: One per joint that is not locked; None: that of ``robot.toml``, else 0, or
            mid-range where 0 is not within limits.
        gravity_m_s2: (3,); None: that of ``robot.toml``, else (0, 0, -9.81).
        plant: One of ``CLOSED_FORMS``: the robot of that name, whose equations of motion
            are the closed form.
        joints_per_bus: Wire the drives to can0, can1, … anew, so many on a bus at most; None:
            as ``robot.toml`` has it.
        unstated_joints_per_bus: The same, where nothing says how the drives are wired: of a
            bare URDF.
        stored: What a log holds of it, ``robot.toml`` and the URDF's text, in place of the files
            that ``name``, ``urdf`` or ``plant`` lead to.

    Raises:
        InputError: Whatever about the robot is wrong or not supported.
    """
    one_robot(name, urdf, plant, "robot")
    form = None if plant is None else closed_form(plant)
    if stored is not None:
        config, xml = stored
        path, where = Path(config.urdf), "robot.toml"
    elif urdf is not None:
        path = find_urdf(urdf)
        config, where = RobotConfig(name=path.stem, urdf=str(path)), str(path)
    else:
        config, file = load_robot_config(name or (form.name if form else ""))
        path, where = find_urdf(config.urdf, beside=file.parent), str(file)
    if form is None and config.plant is not None:
        form = closed_form(config.plant)

    checked = read_urdf(path) if stored is None else check_urdf(path, xml)
    full = parse_model(checked)
    all_limits = joint_limits(full, checked)
    by_file = _hold({}, all_limits, config.lock, config.lock_rad, {}, f"{where}: lock")
    home = _home_in_file(config, all_limits, by_file, where)
    locked = _hold(by_file, all_limits, lock, lock_rad, home, "robot.lock")
    joints = tuple(joint for joint in all_limits.joints if joint not in locked)
    if not joints:
        raise InputError("robot.lock", "every joint is locked", "at least one that can move")
    for joint in checked.joints:
        if joint.mimics and joint.name in joints:
            found = f"joint '{joint.name}' mimics '{joint.mimics}': it has no drive of its own"
            raise InputError(str(path), found, f"it to be locked: lock = ['{joint.name}', ...]")

    limits = all_limits.take(joints)
    if home_rad is None:
        start = np.array([home[joint] for joint in joints])
        limits.check(start, f"{where}: home_rad")
    else:
        start = _vector(home_rad, joints, "robot.home_rad")
        limits.check(start, "robot.home_rad")
    gravity = config.gravity_m_s2 if gravity_m_s2 is None else gravity_m_s2
    drives = _drives(config, all_limits, by_file, limits, unstated_joints_per_bus, where)
    if joints_per_bus is not None:
        drives = on_new_buses(drives, joints_per_bus)
    _refuse_extremes(drives, where)
    if form is not None:
        check_fit(form, drives, lock, gravity_m_s2, where)
    stated = {entry.name for entry in config.joint if entry.torque_limit_nm is not None}

    model = _reduce(full, all_limits, locked)
    model.gravity = pin.Motion(_vector(gravity, "xyz", "robot.gravity_m_s2"), np.zeros(3))
    robot = Robot(
        name=config.name,
        description=config.description or f"{path.name}, {len(joints)} joints",
        model=model,
        joints=joints,
        lower=limits.lower,
        upper=limits.upper,
        velocity_limit=_readonly([drive.velocity_limit_rad_s for drive in drives]),
        torque_limit=_readonly([drive.torque_limit_nm for drive in drives]),
        torque_limit_assumed=limits.torque_assumed & [name not in stated for name in joints],
        home=_readonly(start),
        continuous=limits.continuous,
        prismatic=limits.prismatic,
        gravity=_readonly(gravity),
        joint_config=drives,
        profile=config.profile,
        gains=dict(config.gains),
        locked=locked,
        urdf=checked,
        config=config,
        package_dirs=package_dirs(checked),
        closed_form=form,
        idx_q=tuple(model.idx_qs)[1:],
    )
    _refuse_impossible(robot)
    _refuse_singular(robot)
    model.armature = np.array([drive.armature for drive in drives])
    return robot


def _hold(
    held: dict[str, float],
    limits: JointLimits,
    names: Sequence[str],
    angles: Sequence[float] | None,
    home: dict[str, float],
    where: str,
) -> dict[str, float]:
    """Add joints to those held fixed: at ``angles``, else at home, else at neutral."""
    held = dict(held)
    given = None if angles is None else _vector(angles, names, f"{where}_rad")
    neutral = dict(zip(limits.joints, limits.neutral().tolist(), strict=True))
    for index, name in enumerate(names):
        if name not in limits.joints:
            expected = "one of " + ", ".join(limits.joints)
            raise InputError(where, f"'{name}' is no joint that can move", expected)
        if given is not None:
            held[name] = float(given[index])
        elif name not in held:
            held[name] = home.get(name, neutral[name])
        limits.take([name]).check(np.array([held[name]]), f"{where}_rad")
    return held


def _refuse_extremes(drives: Sequence[JointConfig], where: str) -> None:
    """Refuse what neither a drive nor the arithmetic has room for, wherever it was stated."""
    for drive in drives:
        for key, (low, high) in RANGES.items():
            if not low <= getattr(drive, key) <= high:
                found = f"{key} of joint '{drive.name}' is {getattr(drive, key):g}"
                raise InputError(where, found, f"{low:g} to {high:g}")


def _home_in_file(
    config: RobotConfig, limits: JointLimits, held: dict[str, float], where: str
) -> dict[str, float]:
    """Home of every joint that ``robot.toml`` leaves free."""
    free = limits.take([name for name in limits.joints if name not in held])
    if config.home_rad is None:
        home = free.neutral()
    else:
        home = _vector(config.home_rad, free.joints, f"{where}: home_rad")
    return dict(zip(free.joints, home.tolist(), strict=True))


def _drives(
    config: RobotConfig,
    all_limits: JointLimits,
    held: dict[str, float],
    limits: JointLimits,
    joints_per_bus: int,
    where: str,
) -> tuple[JointConfig, ...]:
    """Drive of each free joint: as in ``robot.toml``, or the defaults of a bare URDF."""
    torque, velocity = limits.torque.tolist(), limits.velocity.tolist()
    if not config.joint:
        return default_joints(limits.joints, torque, joints_per_bus, velocity)
    expected = [name for name in all_limits.joints if name not in held]
    found = [entry.name for entry in config.joint]
    if found != expected:
        names = ", ".join(expected)
        raise InputError(f"{where}: joint", "found " + ", ".join(found), f"in this order: {names}")
    place = {name: index for index, name in enumerate(limits.joints)}
    # The place in the whole robot, not among the free joints: locking renumbers no node.
    return tuple(
        resolve_joint(entry, number, torque[place[entry.name]], velocity[place[entry.name]])
        for number, entry in enumerate(config.joint, start=1)
        if entry.name in place
    )


def _reduce(full: Any, limits: JointLimits, locked: dict[str, float]) -> Any:
    """Remove the locked joints from the model; their links stay, fixed to their parents."""
    if not locked:
        return full
    reference = pin.neutral(full)
    for name, angle in locked.items():
        k = full.idx_qs[full.getJointId(name)]
        if limits.continuous[limits.joints.index(name)]:
            reference[k : k + 2] = np.cos(angle), np.sin(angle)
        else:
            reference[k] = angle
    return pin.buildReducedModel(full, [full.getJointId(name) for name in locked], reference)


def _refuse_impossible(robot: Robot) -> None:
    """Refuse a body that would turn the faster the more it is held back.

    Whether the mass matrix is positive at home does not tell: a negative moment of inertia may
    lie about an axis that another pose turns into a joint's. With a mass and a rotational inertia
    that are not negative, no motion has an energy below 0, whatever the pose. The triangle
    inequality is not asked for: many published URDFs break it, and nothing here needs it.
    """
    for name, body in zip(robot.joints, robot.model.inertias[1:], strict=True):
        if not np.isfinite(body.inertia).all():
            continue  # neither is the mass matrix, then
        size = np.abs(body.inertia).max() or 1.0  # its square may be beyond every number
        eigenvalues = np.linalg.eigvalsh(body.inertia / size) * size
        if not eigenvalues[0] >= -max(_ROUNDING * abs(eigenvalues[-1]), _MIN_INERTIA):
            found = f"joint '{name}' moves a body with a moment of {eigenvalues[0]:g} kg m^2"
            raise InputError(str(robot.urdf_path), found, "an <inertia> not below 0 about any axis")


def _refuse_singular(robot: Robot) -> None:
    """Refuse a mass matrix, without armature, that is not positive definite at home.

    Armature would hide it, and the mass properties are wrong then.
    """
    where, expected = str(robot.urdf_path), "links with mass and inertia"
    M = pin.crba(robot.model, robot.model.createData(), robot.configuration(robot.home))
    diagonal = M.diagonal().copy()
    if not np.isfinite(M).all():
        raise InputError(where, "the mass matrix is not finite", expected)
    for name, inertia in zip(robot.joints, diagonal, strict=True):
        if not inertia > _MIN_INERTIA:
            raise InputError(where, f"joint '{name}' moves no mass", expected + ", or it locked")
    scale = 1.0 / np.sqrt(diagonal)
    eigenvalues, vectors = np.linalg.eigh(scale[:, None] * M * scale, UPLO="U")
    if not eigenvalues[0] > _MIN_EIGENVALUE:
        moved = np.abs(vectors[:, 0]) > 0.1  # the motion that no inertia resists
        names = ", ".join(name for name, used in zip(robot.joints, moved, strict=True) if used)
        raise InputError(where, f"the mass matrix is singular at home (joints {names})", expected)


def _vector(values: Sequence[float], names: Sequence[str], where: str) -> Array:
    """A finite number per name."""
    try:
        vector = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(where, f"found {values!r}", f"{len(names)} numbers") from None
    if vector.shape != (len(names),):
        expected = f"{len(names)}, for " + ", ".join(names)
        raise InputError(where, f"found {vector.size} numbers", expected)
    if not np.isfinite(vector).all():
        raise InputError(where, f"found {vector.tolist()}", "finite numbers")
    return vector


def _readonly(values: Sequence[float] | Array) -> Array:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
