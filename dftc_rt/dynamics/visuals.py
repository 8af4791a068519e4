"""What a robot looks like: the shapes of its URDF, and where its joints carry them.

A URDF without shapes, or one whose meshes are not found, is drawn as a stick figure, and
:attr:`Visuals.note` says so.

Source: pinocchio.buildGeomFromUrdfString; meshes are read by its own loader (assimp).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.urdf import captured, data_dir

F64 = NDArray[np.float64]

_GREY: Final = (0.75, 0.75, 0.75)
_THICKNESS: Final = 0.05  # radius of a stick, of the longest one
_SHORTEST: Final = 1e-3  # m; a stick below this is a point
_UNTOLD: Final = (0.9, 0.9, 0.9)  # Pinocchio's colour where the URDF has none


@dataclass(frozen=True)
class Mesh:
    """Triangles: ``vertices`` (V, 3) float32, m; ``faces`` (T, 3) uint32."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


@dataclass(frozen=True)
class Box:
    """A box with these edges, m, about its centre."""

    size: tuple[float, float, float]


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z, about its centre, m."""

    radius: float
    length: float


@dataclass(frozen=True)
class Sphere:
    """A sphere about its centre, m."""

    radius: float


Shape = Mesh | Box | Cylinder | Sphere


@dataclass(frozen=True)
class Visual:
    """One shape, fixed to what a joint moves.

    Attributes:
        joint: Index of that joint; -1: the base, which stands.
        translation: In the joint's frame, (3,), m.
        quaternion: (4,), w x y z.
        shape: The shape.
        colour: Red, green, blue in [0, 1].
    """

    joint: int
    translation: F64
    quaternion: F64
    shape: Shape
    colour: tuple[float, float, float]


class Visuals:
    """The shapes of a robot.

    Attributes:
        shapes: All of them.
        note: Why this is a stick figure; "" when it is the URDF's own looks.
    """

    def __init__(self, robot: Robot) -> None:
        """Load the shapes; meshes take a second or two."""
        self._robot = robot
        self._data = robot.model.createData()
        self.note = ""
        try:
            self.shapes = _of_urdf(robot)
        except ValueError as error:
            self.note = f"drawn as sticks: {error}"
            self.shapes = []
        if not self.shapes:
            self.note = self.note or "drawn as sticks: the URDF has no shapes"
            self.shapes = _sticks(robot)

    def poses(self, q: F64, out: F64) -> None:
        """Where the joints are in the base frame.

        Args:
            q: Position, (n,), rad (m).
            out: (n, 7): translation x y z, m, and quaternion w x y z.
        """
        pin.forwardKinematics(self._robot.model, self._data, self._robot.configuration(q))
        for i in range(self._robot.n):
            out[i, :3], out[i, 3:] = _parts(self._data.oMi[i + 1])


def _of_urdf(robot: Robot) -> list[Visual]:
    """The URDF's shapes.

    Raises:
        ValueError: A mesh is not found, or cannot be read.
    """
    # A log has the URDF's text and not always its place: the installed package has its meshes.
    places = (*robot.package_dirs, data_dir().parents[1], robot.urdf_path.parent)
    said: list[str] = []
    try:
        with warnings.catch_warnings(), captured(1) as said:
            warnings.simplefilter("ignore")  # Pinocchio warns of its own overloads
            found = pin.buildGeomFromUrdfString(
                robot.model, robot.urdf_xml, pin.GeometryType.VISUAL, [str(p) for p in places]
            )
    except Exception as error:  # Boost.Python hands on any C++ exception
        reason = "".join(said).removeprefix("Caught:") or str(error)  # the first of its overloads
        raise ValueError(" ".join(reason.split())) from None
    visuals = []
    for each in found.geometryObjects:
        shape = _shape(each)
        if shape is not None:
            translation, quaternion = _parts(each.placement)
            r, g, b = (float(x) for x in each.meshColor[:3])
            colour = _GREY if (r, g, b) == _UNTOLD else (r, g, b)
            visuals.append(Visual(each.parentJoint - 1, translation, quaternion, shape, colour))
    return visuals


def _shape(each: Any) -> Shape | None:
    """The shape of one of Pinocchio's geometry objects; None for what a URDF cannot have."""
    geometry = each.geometry
    match type(geometry).__name__:
        case "Box":
            x, y, z = (2.0 * float(half) for half in geometry.halfSide)
            return Box((x, y, z))
        case "Cylinder":
            return Cylinder(float(geometry.radius), 2.0 * float(geometry.halfLength))
        case "Sphere":
            return Sphere(float(geometry.radius))
        case name if name.startswith("BVHModel"):
            triangles = [geometry.tri_indices(k) for k in range(geometry.num_tris)]
            faces = np.array([(t[0], t[1], t[2]) for t in triangles], np.uint32)
            return Mesh(np.array(geometry.vertices(), np.float32), faces)
    return None


def _sticks(robot: Robot) -> list[Visual]:
    """A stick from each joint to the next, and a ball on each."""
    model = robot.model
    ends = [np.array(model.jointPlacements[i + 1].translation) for i in range(robot.n)]
    longest = max((float(np.linalg.norm(end)) for end in ends), default=0.0)
    radius = _THICKNESS * max(longest, 10.0 * _SHORTEST)
    straight = np.array([1.0, 0.0, 0.0, 0.0])
    visuals = []
    for i, end in enumerate(ends):
        length = float(np.linalg.norm(end))
        visuals.append(Visual(i, np.zeros(3), straight, Sphere(2.0 * radius), _GREY))
        if length > _SHORTEST:
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length)
            quaternion = np.roll(np.array(turn.coeffs()), 1)
            shape = Cylinder(radius, length)
            visuals.append(Visual(model.parents[i + 1] - 1, end / 2, quaternion, shape, _GREY))
    last = robot.n - 1  # a chain of one joint has a stick all the same: to the mass that it moves
    arm = np.array(model.inertias[last + 1].lever)
    visuals.append(Visual(last, arm, straight, Sphere(2.0 * radius), _GREY))
    return visuals


def _parts(placement: Any) -> tuple[F64, F64]:
    """Translation (3,) and quaternion (4,) w x y z of an SE3."""
    quaternion = np.array(pin.Quaternion(placement.rotation).coeffs())
    return np.array(placement.translation), np.roll(quaternion, 1)
