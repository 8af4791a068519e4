"""The calibration file: what fault-free motion told about a robot, with its standard errors.

Written by ``dftc calibrate``, read by every command through ``control.calibration``; strict in
both directions and meant to be read, and corrected, by people.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from dftc_rt.config import toml
from dftc_rt.errors import InputError

_NonNegative = Annotated[float, Meta(ge=0)]
_Positive = Annotated[float, Meta(gt=0)]

_MOST_INFLATION: Final = 1e4

FORMAT: Final = 1
"""Version of the file."""


class _Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every table: immutable, unknown keys refused."""


class LinkLoad(_Strict, frozen=True, kw_only=True):
    """``[[link]]``: inertial parameters of a last link, load included.

    Attributes:
        joint: The joint that carries the link.
        mass_kg: Mass of link and load.
        mass_std_kg: Its standard error.
        first_moment_kg_m: Mass times centre of mass, in the joint's frame.
        inertia_kg_m2: About the origin of that frame: xx, xy, yy, xz, yz, zz.
    """

    joint: str
    mass_kg: Annotated[float, Meta(gt=0, le=1000)]
    mass_std_kg: _NonNegative = 0.0
    first_moment_kg_m: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float, float, float, float]


class JointCalibration(_Strict, frozen=True, kw_only=True):
    """``[[joint]]``: one joint; ``*_std`` are standard errors.

    Attributes:
        name: Joint name.
        viscous: Viscous friction, Nm s/rad.
        coulomb: Coulomb friction, Nm.
        offset: Torque offset, Nm.
        armature: Rotor inertia seen at the joint, kg m².
        torque_constant: True over nominal torque constant.
        not_excited: Parameters that the data did not determine; they are nominal.
        gains: Settings of the estimator that the residual's statistics ask for, keys of
            ``[control.gains]``; the scenario's own come after and win.
    """

    name: str
    viscous: _NonNegative = 0.0
    viscous_std: _NonNegative = 0.0
    coulomb: _NonNegative = 0.0
    coulomb_std: _NonNegative = 0.0
    offset: float = 0.0
    offset_std: _NonNegative = 0.0
    armature: Annotated[float, Meta(ge=0, le=1000)]
    armature_std: _NonNegative = 0.0
    torque_constant: Annotated[float, Meta(ge=0.2, le=5)] = 1.0
    torque_constant_std: _NonNegative = 0.0
    not_excited: tuple[str, ...] = ()
    gains: dict[str, float] = {}


class Calibration(_Strict, frozen=True, kw_only=True):
    """A calibration file.

    Attributes:
        format: :data:`FORMAT`.
        robot: Name of the robot.
        source: Where the data came from.
        seconds: Length of the data, s.
        false_alarms_per_hour: For which the thresholds were chosen, the whole robot.
        held_out_percent: RMS residual on a run that was not used, per joint, in percent of
            the torque limit.
        link: Last links.
        joint: Every joint, in the robot's order.
    """

    format: int = FORMAT
    robot: str
    source: str = ""
    seconds: _NonNegative = 0.0
    false_alarms_per_hour: _Positive | None = None
    held_out_percent: tuple[float, ...] = ()
    link: tuple[LinkLoad, ...] = ()
    joint: tuple[JointCalibration, ...]


def load_calibration(path: str | Path) -> Calibration:
    """Read a calibration file.

    Raises:
        MissingFileError: There is no such file.
        InputError: It is not a calibration: names file, key path, what was found and expected.
    """
    try:
        found = toml.load(Path(path), Calibration)
    except RecursionError:
        raise InputError(str(path), "nested too deeply", "a calibration file") from None
    if found.format != FORMAT:
        raise InputError(f"{path}: format", f"found {found.format}", f"{FORMAT}")
    for index, link in enumerate(found.link):
        _finite(link, f"{path}: link[{index}]")
    for index, joint in enumerate(found.joint):
        _finite(joint, f"{path}: joint[{index}]")
    return found


def check_joints(calibration: Calibration, robot: str, joints: tuple[str, ...], where: str) -> None:
    """Refuse the calibration of another robot.

    Raises:
        InputError: Another robot, or other joints.
    """
    if calibration.robot != robot:
        raise InputError(f"{where}: robot", f"found '{calibration.robot}'", f"'{robot}'")
    names = tuple(joint.name for joint in calibration.joint)
    if names != joints:
        raise InputError(f"{where}: joint", "found " + ", ".join(names), ", ".join(joints))


def calibration_gains(calibration: Calibration, where: str) -> dict[str, tuple[float, ...]]:
    """Settings of the estimators, one value per joint.

    Raises:
        InputError: A joint lacks a setting that another has.
    """
    for index, joint in enumerate(calibration.joint):
        inflation = joint.gains.get("inflation", 1.0)
        if not 1.0 <= inflation <= _MOST_INFLATION:  # beyond it nothing would ever be noticed
            expected = f"1 to {_MOST_INFLATION:g}"
            raise InputError(f"{where}: joint[{index}].gains.inflation", f"{inflation:g}", expected)
    keys = sorted({key for joint in calibration.joint for key in joint.gains})
    for index, joint in enumerate(calibration.joint):
        for key in keys:
            if key not in joint.gains:
                expected = "the same settings in every joint"
                raise InputError(f"{where}: joint[{index}].gains", f"no '{key}'", expected)
    return {key: tuple(joint.gains[key] for joint in calibration.joint) for key in keys}


def _finite(table: msgspec.Struct, where: str) -> None:
    for key, value in msgspec.structs.asdict(table).items():
        values = value.values() if isinstance(value, dict) else value
        for item in values if not isinstance(values, float | int | str) else (values,):
            if isinstance(item, float) and not math.isfinite(item):
                raise InputError(f"{where}.{key}", f"found {item}", "finite numbers")
