"""Panda with MIT drives on three classical buses, in lock-step and in real time."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.cli.main import run
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.control import signals
from dftc_rt.controller import connect
from dftc_rt.errors import DriveError
from dftc_rt.log.reader import read
from dftc_rt.memory import MemorySink
from dftc_rt.rt.clock import LockstepClock
from hil.simulate import in_process_rig
from tests.integration.commands import (
    DFTC,
    PATIENT,
    Started,
    dftc,
    repeatable,
    rms,
    started,
)
from tests.integration.test_hil import leaves_nothing, off_after

MIT = ("--set", 'bus.profile="mit"')
SHORT = ("--set", "duration_s=1.0", "--set", "fault[0].start_s=0.4")
SHOULDER = 1
BRAKE_CLOSE_S = 0.02  # of the emulated drives, which let go


def simulate(log: Path, *more: str) -> Path:
    options = ("--log", str(log), "--json", *MIT, *SHORT, *more)
    assert run(["simulate", "panda_shoulder_loss", *options]) == 0
    return log


def test_a_loss_is_attributed_and_the_arm_tracks(capsys: pytest.CaptureFixture[str]) -> None:
    settings = ("--set", "duration_s=7", "--set", "fault[0].start_s=3.0", "--json")
    assert run(["simulate", "panda_shoulder_loss", *MIT, *settings]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["end_state"], found["missed_answers"]) == ("done", 0)
    faulty = found["joints"]["panda_joint2"]
    assert faulty["detection_delay_s"] < 0.5
    assert faulty["rho_rmse"] < 0.02
    for joint in found["joints"].values():
        assert joint["false_alarms"] == 0
        assert joint["rmse_healthy_mrad"] < 1.0
        assert joint["rmse_faulty_mrad"] < 1.0


def test_torques_are_those_of_the_wire_and_act_a_cycle_later() -> None:
    settings = ["duration_s=0.3", 'bus.profile="mit"', "fault=[]", "rig.drive.torque_lag_s=0"]
    done, outcome = run_simulation(open_session("panda_shoulder_loss", settings))
    assert outcome.end_state == "done"
    assert done.rig is not None
    running = done.cycle["state"] == 3.0
    sent = done.cycle["tau_cmd"][running]
    # 87 Nm and 12 Nm in 4095 half steps, and none of the even ones.
    halves = sent / (np.array([87.0] * 4 + [12.0] * 3) / 4095)
    np.testing.assert_allclose(halves, np.rint(halves), atol=1e-6)
    assert np.all(np.rint(halves) % 2 == 1)
    # /rig at t logs what acted up to t: the torque that went out at the tick before, computed
    # in the cycle before that one.
    applied = done.rig["tau_applied"]
    first = int(np.argmax(running))
    rows = slice(first + 2, first + 2 + len(sent) - 10)
    assert done.rig["t"][first] == pytest.approx(done.cycle["t"][first])
    np.testing.assert_allclose(applied[rows], sent[: len(sent) - 10], atol=1e-9)


def test_lock_step_gives_the_same_bytes_again_and_over_sockets(tmp_path: Path) -> None:
    first = repeatable(simulate(tmp_path / "one.mcap"))
    assert len(first[0]) > 1000 * 8
    assert len(first[1]) > 1000 * 8
    assert repeatable(simulate(tmp_path / "again.mcap")) == first
    log = tmp_path / "hil.mcap"
    options = ("--lockstep", "--bus", "unix", "--log", log, "--json", "--no-report")
    done = dftc("hil", "panda_shoulder_loss", *options, *MIT, *SHORT)
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout)["buses"]) == {"can0", "can1", "can2"}
    assert repeatable(log) == first
    assert repeatable(simulate(tmp_path / "other.mcap", "--set", "seed=2")) != first


def test_lost_frames_are_as_repeatable(tmp_path: Path) -> None:
    # From the start: drives enter motor mode at different ticks, and some leave it later.
    lossy = ("--set", 'fault=[{bus="can0", kind="frame_loss", probability=0.2}]')
    settings = (*MIT, "--set", "duration_s=0.2", "--set", "supervisor.stale_cycles=100", *lossy)
    logs = [tmp_path / "here.mcap", tmp_path / "there.mcap"]
    assert run(["simulate", "panda_shoulder_loss", "--log", str(logs[0]), "--json", *settings]) == 0
    options = ("--lockstep", "--bus", "unix", "--log", logs[1], "--json", "--no-report")
    done = dftc("hil", "panda_shoulder_loss", *options, *settings)
    assert done.returncode == 0, done.stderr
    here, there = map(repeatable, logs)
    assert len(here[0]) > 200 * 8
    assert there == here


def test_other_ranges_another_host_id_and_longer_answers_do_as_well() -> None:
    opened = open_session(
        "panda_shoulder_loss",
        ["duration_s=1", 'bus.profile="mit"', "bus.mit.answer_bytes=8", "bus.mit.p_max_rad=12.5",
         "bus.mit.host_id=256", "robot.joints_per_bus=1", "fault=[]"],
    )  # fmt: skip
    done, outcome = run_simulation(opened)
    assert outcome.end_state == "done"
    late = (done.cycle["state"] == 3.0) & (done.cycle["t"] > 0.5)
    assert rms(done.cycle["q"][late] - done.cycle["qd"][late]) < 1e-3


def test_joints_without_limits_turn_beyond_the_range_of_a_drive_that_wraps(tmp_path: Path) -> None:
    scenario = tmp_path / "kinova.toml"
    scenario.write_text(
        """
        name = "kinova"
        duration_s = 3.0
        robot.urdf = "kinova_description/robots/kinova.urdf"
        reference.amplitude_rad = 0.35
        bus.profile = "mit"
        bus.mit.position_wraps = true
        bus.mit.p_max_rad = [0.1, 5.5, 6.0, 12.5, 5.8, 12.5]
        """
    )
    done, outcome = run_simulation(open_session(scenario))
    assert outcome.end_state == "done"
    assert done.rig is not None
    assert np.abs(done.rig["q"][:, 0]).max() > 0.15
    cycles = min(len(done.cycle["q"]), len(done.rig["q"]))
    wrong = done.cycle["q"][:cycles] - done.rig["q"][:cycles]
    assert np.abs(wrong).max() < 1e-3


def test_a_safe_stop_leaves_no_drive_in_motor_mode() -> None:
    settings = [
        'bus.profile="mit"',
        "duration_s=2",
        "fault=[]",
        "supervisor.tracking_error_rad=1e-4",
    ]
    done, outcome = run_simulation(open_session("panda_shoulder_loss", settings))
    assert outcome.end_state == "safe stop"
    assert done.cycle["state"][-1] == 6.0
    assert done.rig is not None
    assert not done.rig["v"][-1].any()
    assert not [e for e in done.events if "not confirmed" in e.text]


def test_an_actuator_that_is_lost_is_stopped_at_once() -> None:
    settings = [
        'bus.profile="mit"', "duration_s=3", "fault[0].start_s=1.0", "fault[0].effectiveness=0.05",
    ]  # fmt: skip
    done, outcome = run_simulation(open_session("panda_shoulder_loss", settings))
    assert outcome.end_state == "safe stop"
    assert "panda_joint2" in outcome.reason
    assert done.cycle["state"][-1] == 6.0
    assert signals.ACTUATOR_LOSS in done.cycle["verdict"][:, SHOULDER]


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        ("bus.mit.p_max_rad=2.5", "bus.mit.p_max_rad: ±2.5 rad for panda_joint1"),
        ("bus.mit.t_max_nm=18", "bus.mit.t_max_nm: 18 Nm for panda_joint1"),
        ("bus.mit.v_max_rad_s=1", "bus.mit.v_max_rad_s: 1 rad/s for panda_joint1"),
        ("bus.mit.host_id=3", "bus.mit.host_id: 3 is the node id of panda_joint3"),
        ("bus.mit.host_id=256", "answers with identifier 256 yield to commands to panda_joint1"),
        ("bus.mit.p_max_rad=[12.5]", "bus.mit.p_max_rad: 1 values"),
        ("bus.mit.answer_bytes=7", "bus.mit.answer_bytes"),
        ("bus.mit.range=7", "bus.mit"),
        ("executor.rate_hz=1200", "bus can0: 3 joints at 1200 Hz"),
    ],
)
def test_a_robot_that_does_not_fit_its_drives_is_refused(setting: str, line: str) -> None:
    done = dftc("simulate", "panda_shoulder_loss", *MIT, "--set", setting)
    assert done.returncode == 2
    assert line in done.stderr
    assert done.stderr.strip().count("\n") == 0
    assert "Traceback" not in done.stderr


def test_an_arm_that_is_where_it_cannot_be_is_one_line() -> None:
    wrong = "rig.plant.q0_rad=[3.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.7]"
    done = dftc("simulate", "panda_shoulder_loss", *MIT, "--set", wrong)
    assert done.returncode == 1
    assert (
        "panda_joint1 (node 1 on can0): position 3.000 rad is outside of the joint's limits, "
        "-2.897 to 2.897 rad: is its zero set?" in done.stderr
    )
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("rigs", "line"),
    [
        (["bus.profile=cia402"], "within 1 s; heard identifier 0x701, .*703$"),  # boot-up
        (
            ["bus.profile=mit", "bus.mit.host_id=0x155", "robot.joints_per_bus=1"],
            "within 1 s; heard identifier 0x155$",
        ),
    ],
)
def test_drives_that_do_not_answer_are_one_line(rigs: list[str], line: str) -> None:
    there = open_session("panda_shoulder_loss", rigs)
    here = open_session("panda_shoulder_loss", ["bus.profile=mit"])
    motion = np.zeros((3, here.robot.n))
    motion[0] = here.robot.home
    sink, nothing = MemorySink(there.rig.size), lambda *_: None
    joined = in_process_rig(there.scenario, there.robot, motion, sink, nothing)
    who = r"^panda_joint1 \(node 1 on can0\): no answer to 'leave motor mode' "
    with pytest.raises(DriveError, match=who + line):
        connect(
            here.scenario, here.parts, joined.sockets, LockstepClock(), sink, nothing,
            lambda: False,
        )  # fmt: skip


# --- real time -------------------------------------------------------------------------


def hil(folder: Path, duration_s: float) -> tuple[str | Path, ...]:
    return (
        DFTC, "hil", "panda_shoulder_loss", "--bus", "unix", "--no-report", *PATIENT, *MIT,
        "--set", f"duration_s={duration_s}", "--log", folder / "run.mcap",
    )  # fmt: skip


@pytest.fixture
def long(tmp_path: Path) -> Iterator[Started]:
    """A run that lasts until something ends it."""
    with started(tmp_path / "run", *hil(tmp_path, 600)) as process:
        process.until_running()
        yield process


@pytest.mark.realtime
def test_sigint_is_a_safe_stop(long: Started, tmp_path: Path) -> None:
    pids = list(long.children().values())
    long.process.send_signal(signal.SIGINT)
    assert long.end() == 130
    assert "Traceback" not in long.err
    leaves_nothing(long, pids)
    logged = read(tmp_path / "run.mcap")
    assert 5.0 in logged.cycle["state"]  # came to rest under control
    assert logged.rig is not None
    assert np.all(logged.rig["v"][-1] == 0.0)


@pytest.mark.realtime
def test_killed_controller_leaves_the_drives_to_their_watchdogs(
    long: Started, tmp_path: Path
) -> None:
    pids = long.children()
    os.kill(pids["dftc-controller"], signal.SIGKILL)
    assert long.end() == 1
    assert "Traceback" not in long.err
    leaves_nothing(long, list(pids.values()))
    logged = read(tmp_path / "run.mcap")
    assert logged.rig is not None
    fresh = logged.rig["cmd_age"][:, 0] == 1.0
    assert np.any(logged.rig["tau_applied"][fresh][-1] != 0.0)
    off_after(logged, float(logged.rig["t"][fresh][-1]), BRAKE_CLOSE_S)
