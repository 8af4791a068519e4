"""The identification file: frozen weights of the identifier's networks, one NPZ archive.

Written by ``dftc identify``, read by every command through ``control.identification``, strictly.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config import npz
from dftc_rt.config.calibration import Calibration
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]

FORMAT: Final = 1
"""Version of the file."""
_MOST_JOINTS: Final = 64
_MOST_POINTS: Final = 99  # along one side of the grid, as the settings grid_q, grid_v
_MOST_WEIGHT: Final = {"w_fo": 1e4, "w_go": 10.0}


@dataclass(frozen=True, eq=False)
class Identification:
    """Frozen networks f̂_o and ĝ_o of n joints on m Gaussians each.

    Attributes:
        robot: Name of the robot.
        joints: Joint names, in the robot's order.
        grid: Points of the grid along position and velocity; m is their product.
        width: Width of the Gaussians, in grid spacings.
        q_range: Lowest and highest position of the grid, (n, 2), rad.
        v_range: Highest velocity of the grid, (n,), rad/s; the lowest is its negative.
        w_fo: Ŵ_fo, (n, m), rad/s².
        w_go: Ŵ_go, (n, m), 1.
        visited: Cells in which the training motion has been, (n, m); elsewhere weights are 0.
        interconnection: Where the other joints were put in training: ``frozen``, or one of
            ``desired`` and ``measured``, which differ by the tracking error only.
        calibration: :func:`fingerprint` of the calibration that was in force; "" for none.
        source: Where the data came from.
        seconds: Length of the data, s.
    """

    robot: str
    joints: tuple[str, ...]
    grid: tuple[int, int]
    width: float
    q_range: F64
    v_range: F64
    w_fo: F64
    w_go: F64
    visited: NDArray[np.bool_]
    interconnection: str
    calibration: str
    source: str = ""
    seconds: float = 0.0


_KINDS: Final = {
    "format": "iu", "robot": "U", "joints": "U", "grid": "iu", "width": "f", "q_range": "f",
    "v_range": "f", "w_fo": "f", "w_go": "f", "visited": "b", "interconnection": "U",
    "calibration": "U", "source": "U", "seconds": "f",
}  # fmt: skip


def fingerprint(calibration: Calibration | None) -> str:
    """What of a calibration decides what is left for the networks, as 16 hexadecimal digits.

    Loads, friction, armature and torque constants; not standard errors, variances or thresholds.
    """
    if calibration is None:
        return ""
    physical = ("name", "viscous", "coulomb", "offset", "armature", "torque_constant")
    told = [[getattr(joint, key) for key in physical] for joint in calibration.joint]
    loads = [[x.joint, x.mass_kg, x.first_moment_kg_m, x.inertia_kg_m2] for x in calibration.link]
    return hashlib.sha256(msgspec.json.encode([told, loads])).hexdigest()[:16]


def save_identification(path: str | Path, found: Identification) -> None:
    """Write the file; the same values give the same bytes."""
    arrays: dict[str, Any] = {"format": np.int64(FORMAT)}
    for field in fields(Identification):
        arrays[field.name] = np.asarray(getattr(found, field.name))
    with Path(path).open("wb") as stream:
        np.savez(stream, **arrays)


def load_identification(path: str | Path) -> Identification:
    """Read an identification file.

    Raises:
        MissingFileError: There is no such file.
        InputError: It is not an identification: names file and member, what was found and
            expected.
    """
    found = npz.load(path, _KINDS, "an identification of dftc identify")
    version = _scalar(path, "format", found["format"])
    if version != FORMAT:
        raise InputError(f"{path}: format", f"found {version}", f"{FORMAT}")
    joints = found["joints"]
    if joints.ndim != 1 or not 1 <= len(joints) <= _MOST_JOINTS:
        raise InputError(f"{path}: joints", f"shape {joints.shape}", f"1 to {_MOST_JOINTS} names")
    n = len(joints)
    _shape(path, found, "grid", (2,))
    if not np.all((found["grid"] >= 1) & (found["grid"] <= _MOST_POINTS)):
        raise InputError(f"{path}: grid", f"found {found['grid']}", f"1 to {_MOST_POINTS} points")
    m = int(found["grid"][0]) * int(found["grid"][1])
    for name, shape in (
        ("q_range", (n, 2)), ("v_range", (n,)), ("w_fo", (n, m)), ("w_go", (n, m)),
        ("visited", (n, m)),
    ):  # fmt: skip
        _shape(path, found, name, shape)
    for name, kind in _KINDS.items():
        if kind == "f" and not np.all(np.isfinite(found[name])):
            raise InputError(f"{path}: {name}", "a value is not finite", "finite numbers")
    width, seconds = (float(_scalar(path, key, found[key])) for key in ("width", "seconds"))
    if width <= 0.0 or seconds < 0.0 or not np.all(found["v_range"] > 0.0):
        raise InputError(f"{path}", "a width, range or time is negative or 0", "a range to cover")
    if not np.all(found["q_range"][:, 0] < found["q_range"][:, 1]):
        raise InputError(f"{path}: q_range", "an empty range", "lowest below highest")
    for name, most in _MOST_WEIGHT.items():
        if np.any(np.abs(found[name]) > most):
            largest = float(np.abs(found[name]).max())
            raise InputError(f"{path}: {name}", f"found {largest:g}", f"at most {most:g}")
    text = {name: str(_scalar(path, name, found[name])) for name, k in _KINDS.items() if k == "U"
            and name != "joints"}  # fmt: skip
    if text["interconnection"] not in ("frozen", "desired", "measured"):
        where = f"{path}: interconnection"
        raise InputError(where, f"found {text['interconnection']!r}", "frozen, desired, measured")
    return Identification(
        joints=tuple(str(name) for name in joints),
        grid=(int(found["grid"][0]), int(found["grid"][1])),
        width=width,
        q_range=found["q_range"].astype(np.float64),
        v_range=found["v_range"].astype(np.float64),
        w_fo=found["w_fo"].astype(np.float64),
        w_go=found["w_go"].astype(np.float64),
        visited=found["visited"],
        seconds=seconds,
        **text,
    )


def _scalar(path: str | Path, name: str, array: NDArray[Any]) -> Any:
    _shape(path, {name: array}, name, ())
    return array[()]


def _shape(
    path: str | Path, found: dict[str, NDArray[Any]], name: str, shape: tuple[int, ...]
) -> None:
    if found[name].shape != shape:
        raise InputError(f"{path}: {name}", f"shape {found[name].shape}", f"{shape}")


def check_identification(
    found: Identification,
    robot: str,
    joints: tuple[str, ...],
    interconnection: str,
    calibration: Calibration | None,
    where: str,
) -> None:
    """Refuse what was trained on another robot, or beside another model.

    Raises:
        InputError: Another robot, other joints, another calibration or another split.
    """
    if found.robot != robot:
        raise InputError(f"{where}: robot", f"found '{found.robot}'", f"'{robot}'")
    if found.joints != joints:
        raise InputError(f"{where}: joints", "found " + ", ".join(found.joints), ", ".join(joints))
    if (found.interconnection == "frozen") != (interconnection == "frozen"):
        what = f"trained with '{found.interconnection}'"
        raise InputError(f"{where}: interconnection", what, f"'{interconnection}', as it runs with")
    now = fingerprint(calibration)
    if found.calibration != now:
        what = f"trained with {_named(found.calibration)}, runs with {_named(now)}"
        raise InputError(f"{where}: calibration", what, "the same; train again after calibrating")


def _named(fingerprint: str) -> str:
    return f"calibration {fingerprint}" if fingerprint else "no calibration"


def identification_gains(
    found: Identification, given: dict[str, Any], *, in_law: bool, where: str
) -> dict[str, Any]:
    """Settings of the law that put the networks in force.

    Args:
        found: The identification.
        given: The scenario's own ``[control.gains]``.
        in_law: Give the networks to the law's f̂, ĝ as well.
        where: Name of the file.

    Raises:
        InputError: The scenario sets what the file sets.
    """
    gains: dict[str, Any] = {
        "basis": "grid",
        "grid_q": found.grid[0],
        "grid_v": found.grid[1],
        "basis_width": found.width,
        "w_fo": found.w_fo,
        "w_go": found.w_go,
    }
    if in_law:
        gains |= {"w_f": found.w_fo, "w_g": found.w_go}
    for key in sorted(set(gains) & set(given)):
        raise InputError(f"control.gains.{key}", f"is set by {where} as well", "one of the two")
    return gains


def check_range(found: Identification, lower: F64, upper: F64, speed: F64, where: str) -> None:
    """Refuse networks on another grid than the law's.

    Args:
        found: The identification.
        lower: Lower end of the law's grid, (n,), rad.
        upper: Upper end, (n,), rad.
        speed: Highest velocity, (n,), rad/s.
        where: Name of the file.

    Raises:
        InputError: The limits of a joint have changed since the training.
    """
    told = np.column_stack([found.q_range, found.v_range])
    now = np.column_stack([lower, upper, speed])
    for i in np.flatnonzero(np.any(np.abs(told - now) > 1e-9 * (1.0 + np.abs(now)), axis=1)):
        what = f"{found.joints[i]}: a grid over {np.round(told[i], 4).tolist()}"
        expected = f"the limits {np.round(now[i], 4).tolist()}"
        raise InputError(f"{where}: q_range, v_range", what, expected)
