import math
from typing import Any

import pytest

from dftc_rt.config import toml
from dftc_rt.config.robot import (
    JointEntry,
    RobotConfig,
    default_armature,
    default_joints,
    load_robot_config,
    on_new_buses,
    resolve_joint,
    robot_names,
    robots_dir,
)
from dftc_rt.errors import InputError, MissingFileError


def refused(raw: dict[str, Any]) -> str:
    with pytest.raises(InputError) as caught:
        toml.convert({"name": "a", "urdf": "a.urdf", **raw}, RobotConfig, "robot.toml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ({"node_id": 0}, "joint[0].node_id: found 0 (expected 1 to 127)"),
        ({"node_id": 128}, "joint[0].node_id: found 128 (expected 1 to 127)"),
        ({"sign": 2}, "joint[0].sign: found 2 (expected 1 or -1)"),
        ({"bus": "can 0"}, "joint[0].bus: found 'can 0' (expected a bus name such as can0)"),
        ({"gear": 0}, "joint[0].gear: found 0.0 (expected more than 0, finite)"),
        ({"counts_per_rev": 0}, "joint[0].counts_per_rev: found 0 (expected more than 0, finite)"),
        ({"torque_limit_nm": -1},
         "joint[0].torque_limit_nm: found -1.0 (expected more than 0, finite)"),
        ({"armature": -0.1}, "joint[0].armature: found -0.1 (expected 0 or more, finite)"),
        ({"delay_cycles": -1}, "joint[0].delay_cycles: found -1 (expected 0 to 1000)"),
        ({"zero_offset_rad": math.inf},
         "joint[0].zero_offset_rad: found inf (expected a finite number)"),
    ],
)  # fmt: skip
def test_values_out_of_range(joint, message):
    assert refused({"joint": [{"name": "j", **joint}]}) == f"robot.toml: {message}"


def test_a_node_is_once_on_its_bus_by_default_too():
    joints = [{"name": "a"}, {"name": "b", "node_id": 1}]
    assert "joint[1].node_id: node 1 on can0 is also joint[0]" in refused({"joint": joints})
    joints[1]["bus"] = "can1"
    toml.convert({"name": "a", "urdf": "u", "joint": joints}, RobotConfig, "robot.toml")


def test_joints_and_locks_are_consistent():
    assert "'a' is also joint[0]" in refused({"joint": [{"name": "a"}, {"name": "a"}]})
    assert "lock_rad: found 2 numbers" in refused({"lock": ["a"], "lock_rad": [1, 2]})
    assert "gravity_m_s2" in refused({"gravity_m_s2": [0, 0, math.inf]})
    assert "profile: found 'can'" in refused({"profile": "can"})
    assert "plant: found 'wheel' (expected one of pendulums, pendulums_physical, arm2)" in refused(
        {"plant": "wheel"}
    )


def test_default_joints_fill_few_buses_evenly():
    joints = default_joints([f"j{i}" for i in range(7)], [87.0] * 4 + [12.0] * 3)
    assert [joint.bus for joint in joints] == ["can0"] * 3 + ["can1"] * 2 + ["can2"] * 2
    assert [joint.node_id for joint in joints] == [1, 2, 3, 4, 5, 6, 7]
    assert joints[0].rated_torque_nm == pytest.approx(29.0)
    assert joints[6].torque_limit_nm == 12.0
    assert joints[0].velocity_limit_rad_s == math.inf
    assert [joint.bus for joint in default_joints(["a", "b"], [1.0, 1.0])] == ["can0", "can0"]
    assert [joint.bus for joint in default_joints(["a", "b"], [1.0, 1.0], 1)] == ["can0", "can1"]
    with pytest.raises(InputError, match="joints_per_bus"):
        default_joints(["a"], [1.0], joints_per_bus=0)


def test_default_armature_grows_with_the_drive_up_to_its_ceiling():
    assert default_armature(12.0) == pytest.approx(0.012)
    assert default_armature(50.0) == default_armature(330.0) == pytest.approx(0.05)


def test_every_folder_of_robots_is_listed_and_loads():
    names = robot_names()
    assert {"panda", "ur5", "ur10", "xarm7", "arm2"} <= set(names)
    for name in names:
        config, path = load_robot_config(name)
        assert config.name == name
        assert path == robots_dir() / name / "robot.toml"


@pytest.mark.parametrize(
    "name", ["../robots/panda", "panda/", "", ".", "a/../panda", "/etc", "p\0"]
)
def test_a_name_is_no_path(name):
    with pytest.raises(InputError, match="is no robot name"):
        load_robot_config(name)


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(
        MissingFileError, match=r"no robot 'pandas' .*arm2, panda, pendulums, .*ur10, ur5, xarm7"
    ):
        load_robot_config("pandas")


def test_three_joints_a_bus_at_most():
    for name in robot_names():
        buses = [joint.bus for joint in load_robot_config(name)[0].joint]
        assert max(buses.count(bus) for bus in buses) <= 3


def test_drives_on_new_buses() -> None:
    joints = default_joints([f"j{i}" for i in range(7)], [87.0] * 4 + [12.0] * 3)
    wired = on_new_buses(joints, 4)
    assert [joint.bus for joint in wired] == ["can0"] * 4 + ["can1"] * 3
    assert [joint.node_id for joint in wired] == [1, 2, 3, 4, 5, 6, 7]
    assert {joint.bus for joint in on_new_buses(joints, 7)} == {"can0"}
    assert on_new_buses(joints, 3) == joints


def test_drives_that_would_share_a_node_id() -> None:
    joints = [
        resolve_joint(JointEntry(name=name, bus=bus, node_id=1), 1, 10.0, 1.0)
        for name, bus in (("a", "can0"), ("b", "can1"))
    ]
    assert [joint.bus for joint in on_new_buses(joints, 1)] == ["can0", "can1"]
    line = "robot.joints_per_bus: a and b would share node id 1 on can0"
    with pytest.raises(InputError, match=line):
        on_new_buses(joints, 2)
