"""Panda with moteus drives on CAN FD buses, in lock-step and in real time."""

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
from dftc_rt.log.reader import read
from tests.integration.commands import (
    DFTC,
    PATIENT,
    Started,
    dftc,
    repeatable,
    started,
)
from tests.integration.test_hil import leaves_nothing, off_after

BRAKE_CLOSE_S = 0.02  # of the emulated drives, which let go
MOTEUS = ("--set", 'bus.profile="moteus"', "--set", "robot.joints_per_bus=4")
SHORT = ("--set", "duration_s=1.0", "--set", "fault[0].start_s=0.4")
SHOULDER = 1


def simulate(log: Path, *more: str) -> Path:
    options = ("--log", str(log), "--json", *MOTEUS, *SHORT, *more)
    assert run(["simulate", "panda_shoulder_loss", *options]) == 0
    return log


def test_a_loss_is_attributed_and_the_arm_tracks(capsys: pytest.CaptureFixture[str]) -> None:
    settings = ("--set", "duration_s=7", "--set", "fault[0].start_s=3.0", "--json")
    assert run(["simulate", "panda_shoulder_loss", *MOTEUS, *settings]) == 0
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
    settings = ["duration_s=0.3", "bus.profile=moteus", "fault=[]", "rig.drive.torque_lag_s=0"]
    done, outcome = run_simulation(open_session("panda_shoulder_loss", settings))
    assert outcome.end_state == "done"
    assert done.rig is not None
    running = done.cycle["state"] == 3.0
    sent = done.cycle["tau_cmd"][running]
    hundredths = sent / 0.01
    np.testing.assert_allclose(hundredths, np.rint(hundredths), atol=1e-6)
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
    done = dftc("hil", "panda_shoulder_loss", *options, *MOTEUS, *SHORT)
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout)["buses"]) == {"can0", "can1"}
    assert repeatable(log) == first
    assert repeatable(simulate(tmp_path / "other.mcap", "--set", "seed=2")) != first


def test_one_bus_at_500_hz_gives_the_same_bytes_over_sockets(tmp_path: Path) -> None:
    one = ("--set", "robot.joints_per_bus=7", "--set", "executor.rate_hz=500")
    first = repeatable(simulate(tmp_path / "one.mcap", *one))
    log = tmp_path / "hil.mcap"
    options = ("--lockstep", "--bus", "unix", "--log", log, "--json", "--no-report")
    done = dftc("hil", "panda_shoulder_loss", *options, *MOTEUS, *SHORT, *one)
    assert done.returncode == 0, done.stderr
    assert set(json.loads(done.stdout)["buses"]) == {"can0"}
    assert len(first[0]) > 500 * 8
    assert repeatable(log) == first


def test_lost_frames_are_as_repeatable(tmp_path: Path) -> None:
    # From the start: drives enter position mode at different ticks, and some leave it later.
    lossy = ("--set", 'fault=[{bus="can0", kind="frame_loss", probability=0.2}]')
    settings = (*MOTEUS, "--set", "duration_s=0.2", "--set", "supervisor.stale_cycles=100", *lossy)
    logs = [tmp_path / "here.mcap", tmp_path / "there.mcap"]
    assert run(["simulate", "panda_shoulder_loss", "--log", str(logs[0]), "--json", *settings]) == 0
    options = ("--lockstep", "--bus", "unix", "--log", logs[1], "--json", "--no-report")
    done = dftc("hil", "panda_shoulder_loss", *options, *settings)
    assert done.returncode == 0, done.stderr
    here, there = map(repeatable, logs)
    assert len(here[0]) > 200 * 8
    assert there == here


@pytest.mark.parametrize(
    "settings",
    [
        ["robot.joints_per_bus=7", "executor.rate_hz=500"],  # one bus
        ["bus.moteus.host_id=100", "bus.moteus.watchdog_s=0.05"],  # three, as the robot has it
    ],
)
def test_other_buses_another_host_id_and_watchdogs_do_as_well(settings: list[str]) -> None:
    always = ["duration_s=0.5", "bus.profile=moteus", "fault=[]"]
    done, outcome = run_simulation(open_session("panda_shoulder_loss", [*always, *settings]))
    assert outcome.end_state == "done"
    moving = done.cycle["state"] == 3.0
    assert np.abs(done.cycle["q"][moving] - done.cycle["qd"][moving]).max() < 0.02


def test_a_safe_stop_leaves_no_drive_in_position_mode() -> None:
    settings = [
        "bus.profile=moteus", "duration_s=2", "fault=[]", "supervisor.tracking_error_rad=1e-4",
    ]  # fmt: skip
    done, outcome = run_simulation(open_session("panda_shoulder_loss", settings))
    assert outcome.end_state == "safe stop"
    assert done.cycle["state"][-1] == 6.0
    assert not [e for e in done.events if "not confirmed" in e.text]


def test_an_actuator_that_is_lost_is_stopped_at_once() -> None:
    settings = [
        "bus.profile=moteus", "duration_s=3", "fault[0].start_s=1.0", "fault[0].effectiveness=0.05",
    ]  # fmt: skip
    done, outcome = run_simulation(open_session("panda_shoulder_loss", settings))
    assert outcome.end_state == "safe stop"
    assert "panda_joint2" in outcome.reason
    assert signals.ACTUATOR_LOSS in done.cycle["verdict"][:, SHOULDER]


def test_faults_of_a_bus_act_on_fd_frames() -> None:
    settings = [
        "bus.profile=moteus", "duration_s=0.5",
        'fault=[{kind="frame_loss", bus="can0", probability=0.05, start_s=0.0}]',
    ]  # fmt: skip
    done, outcome = run_simulation(open_session("panda_shoulder_loss", settings))
    assert outcome.end_state == "done"
    assert done.cycle["age"][:, :3].max() >= 1.0
    assert not done.cycle["age"][:, 3:].any()


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ("bus.moteus.host_id=3", "bus.moteus.host_id: 3 is the node id of panda_joint3"),
        ("bus.moteus.watchdog_s=0.015", "bus.moteus.watchdog_s: 0.015 s"),
        ("bus.moteus.watchdog_s=2", "bus.moteus.watchdog_s"),
        ("bus.moteus.watchdog_s=0.01 executor.rate_hz=100", "0.01 s at 100 Hz (expected more"),
        ("bus.moteus.kp=2", "bus.moteus"),
        ("bus.data_bitrate=500000", "bus.data_bitrate: 500000"),
        ("executor.rate_hz=1250 robot.joints_per_bus=5", "bus can0: 4 joints"),  # of 4 and 3
        ("robot.joints_per_bus=0", "robot.joints_per_bus"),
    ],
)
def test_what_does_not_fit_is_refused(settings: str, line: str) -> None:
    given = [word for setting in settings.split() for word in ("--set", setting)]
    done = dftc("simulate", "panda_shoulder_loss", *MOTEUS, *given)
    assert done.returncode == 2
    assert line in done.stderr
    assert done.stderr.strip().count("\n") == 0
    assert "Traceback" not in done.stderr


# --- real time -------------------------------------------------------------------------


def hil(folder: Path, duration_s: float) -> tuple[str | Path, ...]:
    return (
        DFTC, "hil", "panda_shoulder_loss", "--bus", "unix", "--no-report", *PATIENT, *MOTEUS,
        "--set", f"duration_s={duration_s}", "--log", folder / "run.mcap",
    )  # fmt: skip


@pytest.fixture
def long(tmp_path: Path) -> Iterator[Started]:
    """A run that lasts until something ends it."""
    with started(tmp_path / "run", *hil(tmp_path, 600)) as process:
        process.until_running()
        yield process


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
