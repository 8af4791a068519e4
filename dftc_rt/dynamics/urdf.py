"""Find a URDF, check it for what is not supported, and parse it, each failure in one line."""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pinocchio as pin

from dftc_rt.errors import InputError, MissingFileError

MOVABLE: Final = ("revolute", "continuous", "prismatic")
_MULTI_DOF = {
    "floating": "a floating base or joint",
    "planar": "a planar joint (3 degrees of freedom)",
    "spherical": "a spherical joint (3 degrees of freedom)",
}


@dataclass(frozen=True)
class UrdfJoint:
    """A ``<joint>`` as written: name, type, links, axis, and the joint that it mimics ("")."""

    name: str
    type: str
    parent: str
    child: str
    axis: str
    mimics: str


@dataclass(frozen=True)
class Urdf:
    """A checked URDF: its path, text and joints, fixed ones included, in file order."""

    path: Path
    xml: str
    joints: tuple[UrdfJoint, ...]

    @property
    def movable(self) -> tuple[str, ...]:
        """Names of the joints that can move."""
        return tuple(joint.name for joint in self.joints if joint.type in MOVABLE)


def data_dir() -> Path:
    """``example-robot-data/robots`` of the installed package (it may be absent)."""
    return Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots"


def find_urdf(urdf: str | Path, beside: Path | None = None) -> Path:
    """Resolve a path as a user or a ``robot.toml`` gives it.

    Args:
        urdf: A path, or a path below ``example-robot-data/robots``.
        beside: Folder that a relative path is tried in first; None: the working directory.

    Raises:
        MissingFileError: There is no such file in either place.
    """
    path = Path(urdf).expanduser()
    for candidate in ((beside or Path()) / path, data_dir() / path):
        with contextlib.suppress(OSError, ValueError):  # a name too long, or with a NUL
            if candidate.is_file():
                return candidate.resolve()
    expected = "a path, or a path below example-robot-data/robots"
    raise MissingFileError(repr(str(urdf))[1:-1], "no such URDF file", expected)


def read_urdf(path: Path) -> Urdf:
    """Read a URDF and check it.

    Raises:
        InputError: Not readable, or as :func:`check_urdf`.
    """
    try:
        xml = path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        detail = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise InputError(str(path), f"cannot be read: {detail}", "a URDF file") from None
    return check_urdf(path, xml)


def check_urdf(path: Path, xml: str) -> Urdf:
    """Refuse a URDF that has no scalar joint coordinates.

    Args:
        path: Where it lies, or lay when it was logged.
        xml: Its text.

    Raises:
        InputError: Not XML, not a robot, no joint that can move, or a joint with several
            degrees of freedom.
    """
    where = str(path)
    try:
        # Encoded: with an XML declaration that names an encoding, ElementTree refuses str.
        root = ET.fromstring(xml.encode("utf-8"))
    except (ET.ParseError, LookupError, ValueError) as error:
        raise InputError(where, f"no XML: {error}", "a URDF file") from None
    if root.tag != "robot":
        raise InputError(where, f"the root element is <{root.tag}>", "<robot>")
    joints = tuple(_joint(element) for element in root.findall("joint"))
    for joint in joints:
        if joint.type in _MULTI_DOF:
            what = f"joint '{joint.name}' is {_MULTI_DOF[joint.type]}"
            raise InputError(where, what, "a fixed base and joints of one degree of freedom")
        if joint.type not in (*MOVABLE, "fixed"):
            what = f"joint '{joint.name}' is of type '{joint.type}'"
            raise InputError(where, what, "revolute, continuous, prismatic or fixed")
        if joint.type in MOVABLE and not joint.axis.replace(".", "0").strip("0 +-\t\n"):
            raise InputError(where, f"joint '{joint.name}' has no axis", "an axis that is not 0")
    if not any(joint.type in MOVABLE for joint in joints):
        raise InputError(where, "no joint that can move", "a robot with at least one")
    return Urdf(path, xml, joints)


def parse_model(urdf: Urdf) -> Any:
    """Build the Pinocchio model of the whole URDF, the base fixed to the world.

    Raises:
        InputError: The parser refuses it, or complains and goes on without the part that it
            does not understand (an inertia, say); the reason is the parser's own.
    """
    reason = ""
    with captured(2) as chatter:
        try:
            model = pin.buildModelFromXML(urdf.xml)
        except Exception as error:  # Boost.Python hands on any C++ exception
            reason = " ".join(str(error).split())
    complaint = re.search(r"Error:\s*(.+)", "".join(chatter))
    if complaint:
        reason = complaint[1].strip()
    if reason:
        raise InputError(str(urdf.path), f"refused by the URDF parser: {reason}", "a valid URDF")
    for name, inertia in zip(tuple(model.names)[1:], tuple(model.inertias)[1:], strict=True):
        if inertia.mass < 0.0:
            found = f"the link behind joint '{name}' has mass {inertia.mass:g}"
            raise InputError(str(urdf.path), found, "0 or more")
    return model


def package_dirs(urdf: Urdf) -> tuple[Path, ...]:
    """Folders above the URDF in which its ``package://NAME/`` meshes are found.

    Meshes are never needed here; viewers may want them.
    """
    names = set(re.findall(r"package://([^/\"']+)/", urdf.xml))
    return tuple(
        parent for parent in urdf.path.parents if any((parent / name).is_dir() for name in names)
    )


def _joint(element: ET.Element) -> UrdfJoint:
    mimic, axis = element.find("mimic"), element.find("axis")
    return UrdfJoint(
        name=element.get("name", ""),
        type=element.get("type", ""),
        parent=_link(element, "parent"),
        child=_link(element, "child"),
        axis="1 0 0" if axis is None else axis.get("xyz", "1 0 0"),
        mimics="" if mimic is None else mimic.get("joint", "?"),
    )


def _link(joint: ET.Element, role: str) -> str:
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


@contextlib.contextmanager
def captured(descriptor: int) -> Iterator[list[str]]:
    """Catch what C++ libraries write to a descriptor, which ``sys`` does not see.

    Args:
        descriptor: 1, standard output, or 2, standard error.
    """
    lines: list[str] = []
    try:
        saved = os.dup(descriptor)
    except OSError:  # there is none at all: nothing to keep clean
        yield lines
        return
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), descriptor)
        try:
            yield lines
        finally:
            os.dup2(saved, descriptor)
            os.close(saved)
            file.seek(0)
            lines.extend(file.read().decode("utf-8", "replace").splitlines(keepends=True))
