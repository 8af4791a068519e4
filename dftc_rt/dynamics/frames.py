"""Pose of every link relative to its parent link, as ROS ``/tf`` wants it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from dftc_rt.dynamics.model import Robot

Array = npt.NDArray[np.float64]


class LinkTransform(NamedTuple):
    """Pose of a link in its parent's frame: translation (3,) m, quaternion (4,) x y z w."""

    parent: str
    child: str
    translation: Array
    quaternion: Array


class LinkFrames:
    """The whole tree of the URDF, parents before children; locked and fixed joints included.

    Attributes:
        base: Root link.
        links: (parent, child) of each transform, in the order of :meth:`transforms`.
        fixed: Whether each transform never changes (a fixed or a locked joint).
    """

    def __init__(self, robot: Robot) -> None:
        """Order the tree and look up the frames."""
        self._robot = robot
        self._model = robot.model
        self._data = robot.model.createData()
        joints = {joint.child: joint for joint in robot.urdf.joints}
        children = {joint.child for joint in robot.urdf.joints}
        self.base = next(j.parent for j in robot.urdf.joints if j.parent not in children)
        order = [self.base]
        for parent in order:  # grows while it is walked: breadth first
            order.extend(child for child, joint in joints.items() if joint.parent == parent)
        self.links = tuple((joints[child].parent, child) for child in order[1:])
        self.fixed = tuple(joints[child].name not in robot.joints for child in order[1:])
        self._ids = tuple((self._frame(parent), self._frame(child)) for parent, child in self.links)

    def transforms(self, q: Array) -> list[LinkTransform]:
        """Transforms at q (n,), rad, one per joint of the URDF."""
        x = self._robot.configuration(q)
        pin.framesForwardKinematics(self._model, self._data, x)
        placements = self._data.oMf
        result = []
        for (parent, child), (parent_id, child_id) in zip(self.links, self._ids, strict=True):
            relative = placements[parent_id].actInv(placements[child_id])
            rotation = pin.Quaternion(relative.rotation).coeffs()
            result.append(
                LinkTransform(parent, child, np.array(relative.translation), np.array(rotation))
            )
        return result

    def _frame(self, link: str) -> int:
        index: int = self._model.getFrameId(link, pin.FrameType.BODY)
        return index
