"""What a robot looks like: the URDF's shapes where they move, or sticks and a line that says so."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dftc_rt.dynamics.frames import LinkFrames
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.visuals import Cylinder, Mesh, Sphere, Visuals


@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7", "arm2", "pendulums"])
def test_every_joint_carries_a_shape(name: str) -> None:
    robot = load_robot(name)
    found = Visuals(robot)
    assert found.note == ""
    assert {visual.joint for visual in found.shapes} >= set(range(robot.n))
    for visual in found.shapes:
        assert np.isclose(np.linalg.norm(visual.quaternion), 1.0)
        if isinstance(visual.shape, Mesh):
            assert visual.shape.faces.max() < len(visual.shape.vertices)
            assert np.abs(visual.shape.vertices).max() < 1.0  # m, not mm


def test_joints_are_where_the_links_are() -> None:
    # LinkFrames goes from link to link; the joint's frame is its child link's.
    robot = load_robot("ur5")
    q = robot.home + 0.3
    poses = np.empty((robot.n, 7))
    Visuals(robot).poses(q, poses)
    placed = {LinkFrames(robot).base: np.eye(4)}
    for t in LinkFrames(robot).transforms(q):
        x, y, z, w = t.quaternion
        step = np.eye(4)
        step[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        step[:3, 3] = t.translation
        placed[t.child] = placed[t.parent] @ step
    children = {joint.name: joint.child for joint in robot.urdf.joints}
    for i, joint in enumerate(robot.joints):
        where = placed[children[joint]]
        np.testing.assert_allclose(poses[i, :3], where[:3, 3], atol=1e-12)
        w = 0.5 * np.sqrt(1.0 + np.trace(where[:3, :3]))
        assert abs(poses[i, 3]) == pytest.approx(w, abs=1e-9)


def test_a_mesh_that_is_not_there_makes_sticks_and_says_so(
    capfd: pytest.CaptureFixture[str],
) -> None:
    robot = load_robot("ur5")
    xml = robot.urdf.xml.replace("upperarm.dae", "nowhere.dae")
    found = Visuals(dataclasses.replace(robot, urdf=dataclasses.replace(robot.urdf, xml=xml)))
    assert found.note.startswith("drawn as sticks: Mesh ")
    assert "nowhere.dae could not be found" in found.note
    assert {type(visual.shape) for visual in found.shapes} == {Cylinder, Sphere}
    assert {visual.joint for visual in found.shapes} >= set(range(robot.n))
    assert capfd.readouterr() == ("", "")
    sticks = [v for v in found.shapes if isinstance(v.shape, Cylinder)]
    upper = next(v for v in sticks if v.joint == 1)  # from shoulder to elbow, 0.425 m: DH a2
    assert isinstance(upper.shape, Cylinder)
    assert upper.shape.length == pytest.approx(0.425, abs=0.13)
