"""Scales of moteus drives: what the robot file and the scenario make of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dftc_rt.bus.frame import FD_FRAME_SIZE, FRAME_SIZE
from dftc_rt.config.robot import JointEntry, resolve_joint
from dftc_rt.config.scenario import BusTable, MoteusTable
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.moteus.scale import MoteusScale, moteus_scales, scales_of
from dftc_rt.drives.scale import JointScale, torque_grid
from dftc_rt.drives.wiring import fd_bitrate, frame_size, robot_drives
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.errors import InputError
from tests.unit.drives.moteus.moteus_bus import scales


def one(limit: float = 20.0, entry: Any = None, **table: Any) -> MoteusScale:
    joint = resolve_joint(entry or JointEntry(name="elbow"), 4, limit, 3.0)
    return moteus_scales([joint], MoteusTable(**table), np.array([-2.0]), np.array([1.0]))[0]


def test_torque_has_steps_of_10_mnm() -> None:
    scale = one(20.006)
    assert (scale.torque_per_count, scale.max_counts) == (0.01, 2000)
    step, limit = torque_grid(scales(2, torque_constant=0.8), np.array([30.0, 5.003]))
    assert step == pytest.approx([0.008, 0.008])
    assert limit == pytest.approx([14.4, 5.0])


def test_what_the_scenario_says() -> None:
    assert (one().host_id, one().timeout) == (0, 0)
    scale = one(host_id=5, watchdog_s=0.29)
    assert (scale.host_id, scale.timeout) == (5, 29)
    assert (scale.lower, scale.upper) == (-2.0, 1.0)


@pytest.mark.parametrize(
    ("limit", "table", "line"),
    [
        (328.0, {}, r"^elbow\.torque_limit_nm: 328 Nm with bus.profile 'moteus'"),
        (0.009, {}, r"^elbow\.torque_limit_nm: 0.009 Nm"),
        (20.0, {"host_id": 4}, r"^bus\.moteus\.host_id: 4 is the node id of elbow"),
        (20.0, {"watchdog_s": 0.025}, r"^bus\.moteus\.watchdog_s: 0.025 s"),
    ],
)
def test_what_a_drive_cannot_be_told(limit: float, table: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError, match=line):
        one(limit, **table)


def test_drives_of_a_robot() -> None:
    drives = robot_drives(load_robot("panda", joints_per_bus=4), BusTable(profile="moteus"))
    assert [drive.bus for drive in drives] == [0, 0, 0, 0, 1, 1, 1]
    assert [scale.max_counts for scale in scales_of(drives)] == [8700] * 4 + [1200] * 3


def test_drives_of_another_profile() -> None:
    sheet = JointScale(joint="a", counts_per_rev=1000, rated_torque_nm=1.0, max_torque_nm=2.0)
    with pytest.raises(InputError, match="a: no scale of a moteus drive"):
        scales_of([DriveConfig(1, 0, sheet)])


def test_frames_are_can_fd_for_this_profile_alone() -> None:
    for name in ("cia402", "mit"):
        classical = BusTable(profile=name)  # type: ignore[arg-type]
        assert (fd_bitrate(classical), frame_size(classical)) == (None, FRAME_SIZE)
    table = BusTable(profile="moteus", data_bitrate=2_000_000)
    assert (fd_bitrate(table), frame_size(table)) == (2_000_000, FD_FRAME_SIZE)
