import numpy as np
import pinocchio as pin
import pytest

from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.whole_body import WholeBody
from dftc_rt.errors import InputError, MissingFileError

PANDA = "panda_description/urdf/panda.urdf"
FINGERS = ["panda_finger_joint1", "panda_finger_joint2"]
INERTIAL = """<inertial><mass value="1"/><origin xyz="0.1 0 0.2"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>"""
LIMIT = '<limit lower="-1" upper="2" effort="10" velocity="3"/>'


def urdf_of(*joints, inertial=INERTIAL):
    """A chain: base, l0, l1, ... with the joints (type, inner XML) given."""
    links = "".join(f'<link name="l{i}">{inertial}</link>' for i in range(len(joints)))
    parents = ["base", *(f"l{i}" for i in range(len(joints)))]
    body = "".join(
        f'<joint name="j{i}" type="{kind}"><parent link="{parents[i]}"/><child link="l{i}"/>'
        f'<axis xyz="0 1 0"/>{inner}</joint>'
        for i, (kind, inner) in enumerate(joints)
    )
    return f'<?xml version="1.0"?><robot name="r"><link name="base"/>{links}{body}</robot>'


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "r.urdf"
        path.write_text(text)
        return path

    return write


def refused(**arguments):
    with pytest.raises(InputError) as caught:
        load_robot(**arguments)
    text = str(caught.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize("name", ["arm2", "panda", "ur5", "ur10", "xarm7"])
def test_shipped_robots_hold_themselves_at_home_with_ease(name):
    robot = load_robot(name)
    gravity = WholeBody(robot).gravity(robot.home)
    assert (np.abs(gravity) < 0.35 * robot.torque_limit).all()
    assert not robot.torque_limit_assumed.any()
    assert ((robot.lower < robot.home) & (robot.home < robot.upper)).all()
    assert np.isfinite(robot.velocity_limit).all()
    assert [drive.name for drive in robot.joint_config] == list(robot.joints)
    assert robot.torque_limit.tolist() == [d.torque_limit_nm for d in robot.joint_config]
    assert robot.armature.tolist() == [d.armature for d in robot.joint_config]
    # Home is no kinematic singularity.
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, robot.home)
    J = pin.getJointJacobian(model, data, robot.n, pin.LOCAL_WORLD_ALIGNED)
    assert np.linalg.svd(J)[1][min(robot.n, 6) - 1] > 0.1


def test_panda_has_its_datasheet_limits_and_buses():
    robot = load_robot("panda")
    assert robot.torque_limit.tolist() == [87.0] * 4 + [12.0] * 3
    buses = [drive.bus for drive in robot.joint_config]
    assert buses == ["can0"] * 3 + ["can1"] * 2 + ["can2"] * 2
    assert robot.locked == dict.fromkeys(FINGERS, 0.0)
    assert robot.gravity.tolist() == [0.0, 0.0, -9.81]
    assert "<robot" in robot.urdf_xml


def test_locking_keeps_the_home_and_the_nodes_of_the_others():
    robot = load_robot("panda", lock=["panda_joint4", "panda_finger_joint1"])
    assert "panda_joint4" not in robot.joints
    assert [drive.node_id for drive in robot.joint_config] == [1, 2, 3, 5, 6, 7]
    assert robot.locked["panda_joint4"] == -2.0
    whole = load_robot("panda")
    M = WholeBody(whole).mass_matrix(whole.home)
    free = np.array([0, 1, 2, 4, 5, 6])
    np.testing.assert_allclose(
        WholeBody(robot).mass_matrix(robot.home), M[np.ix_(free, free)], atol=1e-12
    )
    at = load_robot("panda", lock=["panda_joint4"], lock_rad=[-1.0])
    assert at.locked["panda_joint4"] == -1.0


def test_a_bare_urdf_gets_defaults():
    robot = load_robot(urdf=PANDA, lock=FINGERS)
    assert robot.name == "panda"
    assert robot.home[0] == 0.0
    assert robot.home[3] == pytest.approx(0.5 * (-3.0718 - 0.0698))  # 0 is not within limits
    assert [drive.node_id for drive in robot.joint_config] == [1, 2, 3, 4, 5, 6, 7]
    assert robot.joint_config[0].rated_torque_nm == pytest.approx(29.0)
    home = [0.1, -0.5, 0.0, -2.0, 0.0, 1.6, 0.7]
    assert load_robot(urdf=PANDA, lock=FINGERS, home_rad=home).home.tolist() == home


def test_limits_that_a_urdf_does_not_state(write):
    none = '<limit effort="0" velocity="0"/>'
    robot = load_robot(urdf=write(urdf_of(
        ("revolute", LIMIT), ("revolute", none), ("continuous", none), ("prismatic", none),
        ("continuous", ""),
    )))  # fmt: skip
    inf = np.inf
    assert robot.lower.tolist() == [-1.0, -inf, -inf, -inf, -inf]
    assert robot.upper.tolist() == [2.0, inf, inf, inf, inf]
    assert robot.velocity_limit.tolist() == [3.0, inf, inf, inf, inf]
    assert robot.torque_limit.tolist() == [10.0, 100.0, 100.0, 500.0, 100.0]
    assert robot.torque_limit_assumed.tolist() == [False, True, True, True, True]
    assert robot.continuous.tolist() == [False, False, True, False, True]
    assert robot.prismatic.tolist() == [False, False, False, True, False]
    assert robot.armature[0] == pytest.approx(0.01)


def test_configuration_of_continuous_joints(write):
    robot = load_robot(urdf=write(urdf_of(("revolute", LIMIT), ("continuous", ""))))
    assert robot.model.nq == 3
    q = np.array([0.3, 2.5])
    expected = [0.3, np.cos(2.5), np.sin(2.5)]
    np.testing.assert_allclose(robot.configuration(q), expected)
    out = np.empty(3)
    assert robot.configuration(q, out) is out
    np.testing.assert_allclose(out, expected)


def test_configuration_without_them_is_q_itself():
    robot = load_robot("ur5")
    q = robot.home.copy()
    assert robot.configuration(q) is q


def test_a_continuous_joint_can_be_locked_anywhere(write):
    path = write(urdf_of(("continuous", ""), ("revolute", LIMIT)))
    robot = load_robot(urdf=path, lock=["j0"], lock_rad=[0.5])
    whole = load_robot(urdf=path)
    gravity = WholeBody(whole).gravity(np.array([0.5, 0.2]))
    assert WholeBody(robot).gravity(np.array([0.2]))[0] == pytest.approx(gravity[1], abs=1e-12)


def test_arrays_are_read_only():
    robot = load_robot("ur5")
    for array in (robot.home, robot.lower, robot.torque_limit, robot.velocity_limit):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_gravity_can_be_given():
    robot = load_robot("ur5", gravity_m_s2=[0, 0, 0])
    np.testing.assert_allclose(WholeBody(robot).gravity(robot.home), 0.0, atol=1e-12)
    assert "gravity_m_s2" in refused(name="ur5", gravity_m_s2=[0, 0])


def test_joint_index():
    robot = load_robot("panda")
    assert robot.joint_index("panda_joint3") == 2
    with pytest.raises(InputError, match="is locked"):
        robot.joint_index(FINGERS[0])
    with pytest.raises(InputError, match="is no joint of the robot"):
        robot.joint_index("joint3")


def test_wrong_arguments_are_refused():
    assert refused() == "robot: found none of them (expected one of name, urdf, plant)"
    assert "found name and urdf" in refused(name="ur5", urdf=PANDA)
    assert "'x' is no joint that can move" in refused(name="ur5", lock=["x"])
    assert "robot.home_rad: found 1 numbers (expected 6," in refused(name="ur5", home_rad=[0])
    assert "joint 'elbow_joint' at 4" in refused(name="ur5", home_rad=[0, 0, 4, 0, 0, 0])
    assert "finite" in refused(name="ur5", home_rad=[0, 0, float("nan"), 0, 0, 0])
    assert "numbers" in refused(name="ur5", home_rad=["a"] * 6)
    assert "every joint is locked" in refused(name="arm2", lock=["joint1", "joint2"])
    assert "within limits" in refused(name="arm2", lock=["joint1"], lock_rad=[7.0])
    assert "robot.lock_rad: found 1 numbers" in refused(
        name="arm2", lock=["joint1", "joint2"], lock_rad=[1.0]
    )


def test_missing_urdf():
    with pytest.raises(MissingFileError, match="no such URDF file"):
        load_robot(urdf="absent.urdf")
    assert "no such URDF file" in refused(urdf="a\0b")
    assert "no such URDF file" in refused(urdf="x" * 5000)


def test_an_unlocked_mimic_joint_is_refused():
    text = refused(urdf=PANDA)
    assert "joint 'panda_finger_joint2' mimics 'panda_finger_joint1'" in text
    assert "lock = ['panda_finger_joint2'" in text


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "no XML"),
        ("<robot", "no XML"),
        ("<sdf/>", "the root element is <sdf>"),
        ('<robot name="r"><link name="base"/></robot>', "no joint that can move"),
        (urdf_of(("floating", "")), "joint 'j0' is a floating base or joint"),
        (urdf_of(("revolute", LIMIT), ("planar", "")), "joint 'j1' is a planar joint"),
        (urdf_of(("helical", LIMIT)), "joint 'j0' is of type 'helical'"),
        (urdf_of(("revolute", "")), "refused by the URDF parser"),
        (urdf_of(("revolute", '<limit lower="2" upper="1" effort="1" velocity="1"/>')),
         "lower below upper"),
        (urdf_of(("revolute", LIMIT)).replace('name="r"', ""), "refused by the URDF parser"),
        (urdf_of(("revolute", LIMIT)).replace('"base"', '"l0"'), "refused by the URDF parser"),
        (urdf_of(("revolute", LIMIT)).replace('child link="l0"', 'child link="x"'),
         "refused by the URDF parser"),
        (urdf_of(("revolute", LIMIT)).replace('mass value="1"', 'mass value="x"'),
         "refused by the URDF parser: Inertial: mass [x] is not a float"),
        (urdf_of(("revolute", LIMIT)).replace('mass value="1"', 'mass value="-1"'),
         "the link behind joint 'j0' has mass -1"),
        (urdf_of(("revolute", LIMIT)).replace('xyz="0 1 0"', 'xyz="0 0.0 -0"'),
         "joint 'j0' has no axis"),
        (urdf_of(("revolute", LIMIT)).replace('mass value="1"', 'mass value="1e308"').replace(
            '"0.1 0 0.2"', '"1e9 0 0"'), "the mass matrix is not finite"),
        (urdf_of(("revolute", LIMIT)).replace('ixz="0"', 'ixz="-0.11"'),
         "joint 'j0' moves a body with a moment of -0.01 kg m^2"),
        (urdf_of(("revolute", LIMIT)).replace('ixz="0"', 'ixz="1e200"'),
         "joint 'j0' moves a body with a moment of -1e+200 kg m^2"),
        (urdf_of(("revolute", LIMIT), ("fixed", "")).replace('"1"', '"1e308"'),
         "the mass matrix is not finite"),
        (urdf_of(("revolute", LIMIT), inertial=""), "joint 'j0' moves no mass"),
        (urdf_of(("revolute", LIMIT), ("revolute", LIMIT)).replace(
            f'<link name="l0">{INERTIAL}', '<link name="l0">'), "is singular at home"),
    ],
)  # fmt: skip
def test_urdfs_that_are_refused(write, text, part, capfd):
    path = write(text)
    message = refused(urdf=path)
    assert message.startswith(str(path))
    assert part in message
    assert capfd.readouterr() == ("", "")  # nothing from the C++ libraries


def test_a_urdf_that_is_no_text(tmp_path):
    path = tmp_path / "r.urdf"
    path.write_bytes(b"\xff\xfe\x00")
    assert "not UTF-8 text" in refused(urdf=path)


def test_stderr_works_after_a_refusal(write, capfd):
    import os

    refused(urdf=write(urdf_of(("revolute", ""))))
    os.write(2, b"still here")
    assert capfd.readouterr().err == "still here"


def test_a_robot_file_that_does_not_fit_its_urdf(tmp_path, monkeypatch):
    folder = tmp_path / "bot"
    folder.mkdir()
    (folder / "bot.urdf").write_text(urdf_of(("revolute", LIMIT), ("revolute", LIMIT)))
    monkeypatch.setattr("dftc_rt.config.robot.robots_dir", lambda: tmp_path)

    def write_toml(text):
        (folder / "robot.toml").write_text('name = "bot"\nurdf = "bot.urdf"\n' + text)

    write_toml("")
    assert load_robot("bot").joints == ("j0", "j1")
    write_toml('[[joint]]\nname = "j1"\n[[joint]]\nname = "j0"\n')
    assert "joint: found j1, j0 (expected in this order: j0, j1)" in refused(name="bot")
    write_toml("home_rad = [0]\n")
    assert "home_rad: found 1 numbers" in refused(name="bot")
    write_toml("home_rad = [0, 3]\n")
    assert "home_rad: joint 'j1' at 3 (expected within limits, -1 to 2)" in refused(name="bot")
    write_toml('lock = ["j9"]\n')
    assert "lock: 'j9' is no joint that can move" in refused(name="bot")
    write_toml('[[joint]]\nname = "j0"\ntorque_limit_nm = 5\n[[joint]]\nname = "j1"\n')
    assert load_robot("bot").torque_limit.tolist() == [5.0, 10.0]
    assert [drive.node_id for drive in load_robot("bot").joint_config] == [1, 2]
    assert [drive.node_id for drive in load_robot("bot", lock=["j0"]).joint_config] == [2]
    (folder / "robot.toml").write_text('name = "other"\nurdf = "bot.urdf"\n')
    assert "name: found 'other' (expected 'bot', as its folder)" in refused(name="bot")
