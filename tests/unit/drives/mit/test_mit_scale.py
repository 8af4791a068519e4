"""Ranges: defaults, what does not fit, and the torques that can be commanded."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from dftc_rt.config.robot import JointEntry, resolve_joint
from dftc_rt.config.scenario import BusTable, MitTable
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.mit.scale import MitScale, mit_scales, scales_of
from dftc_rt.drives.scale import JointScale, ScaleTable, torque_grid
from dftc_rt.drives.wiring import robot_drives
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.errors import InputError
from tests.unit.drives.mit.mit_bus import scales


def joint(**changes: Any):
    return resolve_joint(JointEntry(name="elbow", **changes), 4, 20.0, 3.0)


def one(lower: float = -2.0, upper: float = 1.0, entry: Any = None, **table: Any) -> MitScale:
    joints = [entry or joint()]
    return mit_scales(joints, MitTable(**table), np.array([lower]), np.array([upper]))[0]


def test_ranges_follow_from_the_limits() -> None:
    scale = one()
    assert (scale.p_max, scale.v_max, scale.t_max) == pytest.approx((2.1, 4.5, 20.0))
    assert (scale.kp_max, scale.kd_max, scale.host_id) == (500.0, 5.0, 0)
    assert one(entry=joint(zero_offset_rad=-0.5)).p_max == pytest.approx(1.05 * 2.5)


def test_joints_without_limits_get_the_published_ranges() -> None:
    endless = resolve_joint(JointEntry(name="wheel"), 1, 20.0, math.inf)
    scale = one(-math.inf, math.inf, endless, position_wraps=True)
    assert (scale.p_max, scale.v_max) == (12.5, 45.0)


def test_what_is_given_is_taken_for_all_joints_or_for_each() -> None:
    robot = load_robot("panda")
    table = MitTable(p_max_rad=12.5, t_max_nm=(90.0, 91.0, 92.0, 93.0, 14.0, 15.0, 16.0))
    found = scales_of(robot_drives(robot, BusTable(profile="mit", mit=table)))
    assert {s.p_max for s in found} == {12.5}
    assert [s.t_max for s in found] == [90.0, 91.0, 92.0, 93.0, 14.0, 15.0, 16.0]


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ({"p_max_rad": 1.9},
         "bus.mit.p_max_rad: ±1.9 rad for elbow "
         "(expected its whole range, up to ±2 rad at the drive)"),
        ({"p_max_rad": 2.2, "entry": joint(zero_offset_rad=-0.5)},
         "bus.mit.p_max_rad: ±2.2 rad for elbow "
         "(expected its whole range, up to ±2.5 rad at the drive)"),
        ({"lower": -math.inf},
         "bus.mit.position_wraps: elbow turns without end, and its drive's position ends at ±p_max "
         "(expected true, if the drive goes on from the other end there)"),
        ({"v_max_rad_s": 2.5},
         "bus.mit.v_max_rad_s: 2.5 rad/s for elbow "
         "(expected its velocity limit, 3 rad/s, or more)"),
        ({"t_max_nm": 18.0},
         "bus.mit.t_max_nm: 18 Nm for elbow (expected its torque limit, 20 Nm, or more)"),
        ({"p_max_rad": (1.0, 2.0)},
         "bus.mit.p_max_rad: 2 values (expected one, or 1, one per joint)"),
        ({"host_id": 4}, "bus.mit.host_id: 4 is the node id of elbow (expected another one)"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_one_line(arguments: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError) as error:
        one(**arguments)
    assert str(error.value) == line


def test_a_drive_of_another_profile_has_no_ranges() -> None:
    sheet = JointScale("elbow", 1000, 50.0, 100.0)
    with pytest.raises(InputError, match="elbow: no ranges of an MIT drive"):
        scales_of([DriveConfig(1, 0, sheet)])


def test_torques_are_odd_half_steps() -> None:
    # Half a step is 18 / 4095 Nm. The range's end is the 4095th, an odd one; 10 Nm are
    # 2275 half steps; 10.01 Nm are 2277.3, of which 2277 exist; 10.005 Nm are 2276.1, of
    # which 2275 do.
    half = 18.0 / 4095
    for limit, counts in ((18.0, 4095), (10.0, 2275), (10.01, 2277), (10.005, 2275)):
        (sheet,) = scales(1, max_torque_nm=limit)
        assert sheet.max_counts == counts
        step, most = torque_grid([sheet], np.array([limit]))
        assert step.tolist() == [0.0]  # a law is not to round: no multiple of a step exists
        assert most == pytest.approx([counts * half], rel=1e-12)
    table = ScaleTable.of(scales(1, sign=-1, torque_constant=0.9))
    assert table.torque(np.array([4095])) == pytest.approx([-0.9 * 18.0])


def test_torque_grid_of_drives_that_count_in_per_mille() -> None:
    # 50 Nm rated: 0.05 Nm a count; 99.99 Nm are 1999 whole counts.
    step, most = torque_grid([JointScale("a", 1000, 50.0, 100.0)], np.array([99.99]))
    assert (step, most) == (pytest.approx([0.05]), pytest.approx([99.95]))
