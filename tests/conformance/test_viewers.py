"""Logs as others read them: ROS 2's definitions, Rerun's loader.

Every number is compared with what our own reader finds.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from dftc_rt.cli.main import run as dftc
from dftc_rt.dynamics.frames import LinkFrames
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.log.reader import read

RERUN = Path(sys.executable).with_name("rerun")
TOPICS = ("/cycle", "/rig", "/events", "/joint_states", "/tf", "/robot_description")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("viewers") / "run.mcap"
    assert (
        dftc(["simulate", "panda_shoulder_loss", "--set", "duration_s=0.5", "--log", str(path)])
        == 0
    )
    return path


def decoded(log: Path, topic: str) -> list[tuple[int, Any]]:
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [(m.log_time, found) for _, _, m, found in reader.iter_decoded_messages([topic])]


def test_joint_states_are_ros_2_messages_with_the_numbers_of_the_cycle(log: Path) -> None:
    run = read(log)
    states = decoded(log, "/joint_states")
    assert len(states) > 20
    for log_time, state in states:
        at = int(np.argmin(np.abs(run.cycle["t"] * 1e9 - log_time)))
        assert tuple(state.name) == run.joints
        assert state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == log_time
        np.testing.assert_array_equal(state.position, run.cycle["q"][at])
        np.testing.assert_array_equal(state.velocity, run.cycle["v"][at])
        np.testing.assert_array_equal(state.effort, run.cycle["tau_cmd"][at])


def test_transforms_are_those_of_the_kinematics(log: Path) -> None:
    run = read(log)
    frames = LinkFrames(load_robot("panda"))
    transforms = decoded(log, "/tf")
    assert len(transforms) == len(decoded(log, "/joint_states"))
    log_time, message = transforms[len(transforms) // 2]
    at = int(np.argmin(np.abs(run.cycle["t"] * 1e9 - log_time)))
    expected = list(frames.transforms(run.cycle["q"][at]))
    assert len(message.transforms) == len(expected)
    for found, link in zip(message.transforms, expected, strict=True):
        assert (found.header.frame_id, found.child_frame_id) == (link.parent, link.child)
        place, turn = found.transform.translation, found.transform.rotation
        np.testing.assert_allclose([place.x, place.y, place.z], link.translation, atol=1e-15)
        np.testing.assert_allclose([turn.x, turn.y, turn.z, turn.w], link.quaternion, atol=1e-15)


def test_robot_description_is_the_urdf(log: Path) -> None:
    ((_, message),) = decoded(log, "/robot_description")
    assert message.data == load_robot("panda").urdf_xml


def rerun(folder: Path, *arguments: str | Path) -> str:
    # a home of its own: the program keeps settings there
    environment = os.environ | {"HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    done = subprocess.run(
        [RERUN, *map(str, arguments)], capture_output=True, text=True, timeout=120, env=environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_rerun_finds_nothing_wrong(log: Path, tmp_path: Path) -> None:
    found = rerun(tmp_path, "mcap", "check", "--full", log)
    rows = [line.split() for line in found.splitlines() if line.split()[3:4] != []]
    assert {row[3]: row[0] for row in rows if row[3] in TOPICS} == dict.fromkeys(TOPICS, "ok")


def test_rerun_loads_robot_transforms_and_numbers(log: Path, tmp_path: Path) -> None:
    file = tmp_path / "run.rrd"
    rerun(tmp_path, "mcap", "convert", log, "-o", file)
    found = rerun(tmp_path, "rrd", "print", "-vv", file)
    for what in ("/tf", "/joint_states/position", "/cycle", "/rig", "visual_geometries"):
        assert what in found
    assert "rho_hat_panda_joint2" in found
