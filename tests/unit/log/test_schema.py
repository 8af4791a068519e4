"""Layout of a record and its ROS 2 definition."""

from __future__ import annotations

import pytest
from mcap_ros2._vendor.rosidl_adapter.parser import parse_message_string

from dftc_rt.control.signals import NAMES
from dftc_rt.errors import InputError
from dftc_rt.log.schema import cycle_layout, rig_layout
from dftc_rt.rt import executor


def test_fields_are_header_then_rows_by_joint() -> None:
    layout = rig_layout(["base", "arm-2"])
    assert layout.fields == (
        "t",
        "q_base", "q_arm_2",
        "v_base", "v_arm_2",
        "tau_applied_base", "tau_applied_arm_2",
        "rho_base", "rho_arm_2",
        "fault_base", "fault_arm_2",
        "cmd_age_base", "cmd_age_arm_2",
    )  # fmt: skip
    assert layout.size == 13
    assert (layout.topic, layout.schema) == ("/rig", "dftc_rt/msg/Rig")


def test_cycle_has_the_executors_header() -> None:
    layout = cycle_layout(["a"], NAMES)
    assert layout.header == executor.HEADER
    assert layout.size == 7 + 15
    assert layout.fields[7:10] == ("q_a", "v_a", "qd_a")


def test_definition_is_what_rosidl_parses() -> None:
    layout = cycle_layout(["panda_joint1", "j2"], NAMES)
    parsed = parse_message_string("dftc_rt", "Cycle", layout.definition)
    assert tuple(field.name for field in parsed.fields) == layout.fields
    assert {str(field.type) for field in parsed.fields} == {"float64"}


@pytest.mark.parametrize(
    ("joints", "who"),
    [
        (["a.b", "a_b"], "q_a_b"),
        (["x", "x"], "q_x"),
        (["law_x", "x", "d"], "clash"),
        ([], "no joints"),
    ],
)
def test_clashing_names_are_refused(joints: list[str], who: str) -> None:
    rows = ("q", "tau", "tau_law")
    with pytest.raises(InputError, match=who):
        cycle_layout(joints, rows)


@pytest.mark.parametrize("joint", ["LF_HAA", "a__b", "end_"])
def test_names_outside_ros_2_limits_are_logged_as_they_are(joint: str) -> None:
    layout = cycle_layout([joint], ("q",))
    assert layout.fields[-1] == f"q_{joint}"
    with pytest.raises(NameError):
        parse_message_string("dftc_rt", "Cycle", layout.definition)
