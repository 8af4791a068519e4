"""The robot in the page: its shapes, tinted by effectiveness, and its desired pose as a ghost."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.visuals import Box, Cylinder, Mesh, Sphere, Visual, Visuals

F64 = NDArray[np.float64]

_WEAK: Final = np.array([0.86, 0.10, 0.10])  # colour of a joint that has lost everything
_GHOST: Final = (60, 160, 255)
_GHOST_OPACITY: Final = 0.15
_AMBIENT: Final = 1.2
FIELD_OF_VIEW: Final = 1.0  # rad, from bottom to top
_SHADES: Final = 20  # steps of the tint; only a change of step is sent


class RobotScene:
    """Draws a robot; :meth:`show` moves it."""

    def __init__(self, server: Any, robot: Robot) -> None:
        """Add the robot, its ghost and a floor.

        Args:
            server: A ``viser.ViserServer``.
            robot: The robot.
        """
        self._visuals = Visuals(robot)
        self.note = self._visuals.note
        self._server = server
        n = robot.n
        self._poses: F64 = np.empty((n, 7))
        self._visuals.poses(robot.home, self._poses)
        scene = server.scene
        scene.configure_environment_map(None)  # light from lamps alone
        scene.configure_default_lights(cast_shadow=False)
        scene.add_light_ambient("/light", intensity=_AMBIENT)
        self._bodies = _Bodies(scene, "/robot", self._visuals, n)
        self._ghost = _Bodies(scene, "/desired", self._visuals, n, _GHOST_OPACITY)
        self._bodies.move(self._poses)
        self._ghost.move(self._poses)
        look_at, position, reach = camera(self._poses)
        server.initial_camera.look_at = tuple(look_at)
        server.initial_camera.position = tuple(position)
        server.initial_camera.fov = FIELD_OF_VIEW
        scene.add_grid(
            "/floor", width=4 * reach, height=4 * reach, cell_size=reach / 5,
            section_size=reach, position=(0.0, 0.0, self._lowest(reach)),
        )  # fmt: skip
        self._shades = np.full(n, _SHADES)

    def _lowest(self, reach: float) -> float:
        """Height of the floor: the base, or below what hangs from it."""
        lowest = float(self._poses[:, 2].min())
        return 0.0 if lowest >= 0.0 else lowest - 0.3 * reach

    def show(self, q: F64, desired: F64, rho: F64) -> None:
        """Move the robot.

        Args:
            q: Measured position, (n,), rad (m).
            desired: Desired position, (n,), rad (m).
            rho: Estimated effectiveness, (n,); NaN where there is none.
        """
        with self._server.atomic():
            self._visuals.poses(q, self._poses)
            self._bodies.move(self._poses)
            if self._ghost.visible:
                self._visuals.poses(desired, self._poses)
                self._ghost.move(self._poses)
            left = np.clip(np.nan_to_num(rho, nan=1.0), 0.0, 1.0)
            shades = np.round(left * _SHADES).astype(int)
            for i in np.flatnonzero(shades != self._shades):
                self._bodies.tint(int(i), float(shades[i]) / _SHADES)
            self._shades = shades

    def show_ghost(self, visible: bool) -> None:
        """Show or hide the desired pose."""
        self._ghost.visible = visible


def camera(poses: F64) -> tuple[F64, F64, float]:
    """Where the camera is at first.

    Args:
        poses: Of the joints at home, (n, 7): :meth:`dftc_rt.dynamics.visuals.Visuals.poses`.

    Returns:
        The point that it looks at, (3,), its position, (3,), both m, and the robot's reach, m.
    """
    points = poses[:, :3]
    reach = max(float(np.abs(points).max(initial=0.0)), 0.3)
    centre = 0.4 * (points.max(axis=0) + points.min(axis=0))
    return centre, centre + reach * np.array([1.4, -1.4, 0.7]), reach


class _Bodies:
    """The shapes of a robot below one node of the scene."""

    def __init__(
        self, scene: Any, root: str, visuals: Visuals, n: int, opacity: float | None = None
    ) -> None:
        self._root = scene.add_frame(root, show_axes=False)
        self._frames = [scene.add_frame(f"{root}/{i}", show_axes=False) for i in range(n)]
        self._shapes: list[list[tuple[Any, Visual]]] = [[] for _ in range(n)]
        self._last: F64 = np.full((n, 7), np.nan)
        for k, visual in enumerate(visuals.shapes):
            if opacity is not None and visual.joint < 0:
                continue  # a ghost of what stands tells nothing
            parent = root if visual.joint < 0 else f"{root}/{visual.joint}"
            colour = _GHOST if opacity is not None else _rgb(np.array(visual.colour))
            handle = _add(scene, f"{parent}/shape{k}", visual, colour, opacity)
            if visual.joint >= 0:
                self._shapes[visual.joint].append((handle, visual))

    @property
    def visible(self) -> bool:
        return bool(self._root.visible)

    @visible.setter
    def visible(self, value: bool) -> None:
        self._root.visible = value

    def move(self, poses: F64) -> None:
        """Put the joints' frames at ``poses``, (n, 7); what has not moved is not sent."""
        moved = np.abs(poses - self._last) > 1e-6
        for i, frame in enumerate(self._frames):
            if not np.array_equal(poses[i], self._last[i]):
                if moved[i, :3].any() or np.isnan(self._last[i, 0]):
                    frame.position = poses[i, :3].copy()
                frame.wxyz = poses[i, 3:].copy()
        self._last[:] = poses

    def tint(self, joint: int, share: float) -> None:
        """Colour what a joint moves: its own colour at 1, red at 0."""
        for handle, visual in self._shapes[joint]:
            handle.color = _rgb(share * np.array(visual.colour) + (1.0 - share) * _WEAK)


def _rgb(colour: F64) -> tuple[int, int, int]:
    r, g, b = (round(255 * float(x)) for x in np.clip(colour, 0.0, 1.0))
    return r, g, b


def _add(
    scene: Any, name: str, visual: Visual, colour: tuple[int, int, int], opacity: float | None
) -> Any:
    options = {
        "color": colour,
        "opacity": opacity,
        "position": visual.translation,
        "wxyz": visual.quaternion,
        "cast_shadow": False,
        "receive_shadow": False,
    }
    match visual.shape:
        case Mesh(vertices, faces):
            # What is inside out in a file is seen all the same.
            return scene.add_mesh_simple(name, vertices, faces, side="double", **options)
        case Box(size):
            return scene.add_box(name, dimensions=size, **options)
        case Cylinder(radius, length):
            return scene.add_cylinder(name, radius=radius, height=length, **options)
        case Sphere(radius):
            return scene.add_icosphere(name, radius=radius, **options)
