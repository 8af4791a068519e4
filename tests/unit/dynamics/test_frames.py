import numpy as np
import pytest

from dftc_rt.dynamics.frames import LinkFrames
from dftc_rt.dynamics.robot import load_robot


def test_arm2_by_hand():
    frames = LinkFrames(load_robot("arm2"))
    assert frames.base == "base_link"
    first, second = frames.transforms(np.array([0.6, -0.4]))
    assert (first.parent, first.child) == ("base_link", "link1")
    assert (second.parent, second.child) == ("link1", "link2")
    assert first.translation.tolist() == pytest.approx([0, 0, 0])
    assert second.translation.tolist() == pytest.approx([0, 0, 0.3])
    assert first.quaternion.tolist() == pytest.approx([0, np.sin(0.3), 0, np.cos(0.3)])
    assert second.quaternion.tolist() == pytest.approx([0, np.sin(-0.2), 0, np.cos(-0.2)])


def test_the_whole_tree_of_panda_with_the_locked_fingers():
    robot = load_robot("panda", lock=["panda_joint7"])
    frames = LinkFrames(robot)
    assert frames.base == "panda_link0"
    assert len(frames.links) == len(robot.urdf.joints) == 12
    known = {frames.base}
    for parent, child in frames.links:
        assert parent in known
        known.add(child)
    fixed = {child for (_, child), fixed in zip(frames.links, frames.fixed, strict=True) if fixed}
    assert fixed == {
        "panda_link7", "panda_link8", "panda_hand", "panda_hand_tcp", "panda_leftfinger",
        "panda_rightfinger",
    }  # fmt: skip
    home, away = (frames.transforms(q) for q in (robot.home, robot.home + 0.1))
    for before, after in zip(home, away, strict=True):
        same = np.allclose(before.quaternion, after.quaternion)
        assert same == (before.child in fixed)
        np.testing.assert_allclose(before.translation, after.translation, atol=1e-12)
        assert np.linalg.norm(after.quaternion) == pytest.approx(1.0)


def test_transforms_of_one_call_survive_the_next():
    robot = load_robot("arm2")
    frames = LinkFrames(robot)
    first = frames.transforms(np.zeros(2))[0].quaternion
    frames.transforms(np.ones(2))
    assert first.tolist() == [0, 0, 0, 1]


def test_a_continuous_and_a_prismatic_joint():
    kinova = load_robot(urdf="kinova_description/robots/kinova.urdf")
    assert len(LinkFrames(kinova).transforms(kinova.home)) == 12
    robot = load_robot(urdf="panda_description/urdf/panda.urdf", lock=["panda_finger_joint2"])
    q = robot.home.copy()
    q[robot.joint_index("panda_finger_joint1")] = 0.03
    left = {t.child: t for t in LinkFrames(robot).transforms(q)}["panda_leftfinger"]
    assert left.translation.tolist() == pytest.approx([0, 0.03, 0.0584])
