"""Recorded frames, played back over sockets: the controller sends the same again, or not."""

from __future__ import annotations

import json
import re
import signal
import subprocess
from pathlib import Path

import can as can_package
import numpy as np
import pytest

from dftc_rt.analysis import load
from dftc_rt.bus import unix
from dftc_rt.bus.frame_record import frames_of
from dftc_rt.cli.main import run
from dftc_rt.cli.session import open_session
from tests.integration.commands import DFTC, PATIENT, dftc, repeatable, started

SHORT = ("--set", "duration_s=0.4", "--set", "fault[0].start_s=0.1")
SCENARIO = "panda_shoulder_loss"


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = tmp_path_factory.mktemp("simulated") / "run.mcap"
    assert run(["simulate", SCENARIO, "--frames", "--log", str(log), "--json", *SHORT]) == 0
    return log


@pytest.fixture(scope="module")
def recorded(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = tmp_path_factory.mktemp("recorded") / "run.mcap"
    options = ("--lockstep", "--bus", "unix", "--frames", "--log", log, "--json", "--no-report")
    done = dftc("hil", SCENARIO, *options, *SHORT)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["recorder_dropped"]["can"] == 0
    return log


def play(
    recording: Path, folder: Path, *settings: str, scenario: str = SCENARIO
) -> tuple[int, dict[str, object], Path]:
    """Play a recording to a controller; return the player's exit code, what it found, and the
    controller's log.
    """
    buses = ("--bus", "unix", "--bus-dir", folder / "buses")
    with started(folder / "player", DFTC, "play", recording, *buses, "--json") as player:
        player.until_said("Ctrl-C ends")
        log = folder / "again.mcap"
        options = ("--lockstep", "--frames", "--log", log, "--json", "--no-report")
        dftc("control", scenario, *buses, *options, *settings)
        code = player.end()
        assert not (folder / "buses").exists()
        return code, json.loads(player.out), log


def test_frames_of_hil_and_simulate_are_the_same(simulated: Path, recorded: Path) -> None:
    here, there = load(simulated).can, load(recorded).can
    assert here is not None
    assert there is not None
    assert here.buses == there.buses == ("can0", "can1", "can2")
    for bus in range(3):  # between the buses of a cycle there is no order
        one, other = (can.records[can.records["bus"] == bus] for can in (here, there))
        # In set-up, when an answer is read depends on when it came.
        assert one[one["tx"]].tobytes() == other[other["tx"]].tobytes()
        assert sorted(one["id"].tolist()) == sorted(other["id"].tolist())
        one, other = (records[records["t"] >= 0.0] for records in (one, other))
        assert len(one) > 400 * 4
        assert one.tobytes() == other.tobytes()
    assert repeatable(simulated) == repeatable(recorded)


@pytest.mark.realtime
def test_frames_of_a_run_in_real_time(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    options = ("--bus", "unix", "--frames", "--log", log, "--json", "--no-report", *PATIENT)
    done = dftc("hil", SCENARIO, *options, *SHORT)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["recorder_dropped"]["can"] == 0
    can = load(log).can
    assert can is not None
    of_loop = can.records[can.records["t"] >= 0.0]
    commands = of_loop["tx"] & (of_loop["id"] > 0x200) & (of_loop["id"] < 0x280)
    assert np.count_nonzero(commands) == 7 * said["cycles"]
    answers = ~of_loop["tx"] & (of_loop["id"] > 0x180) & (of_loop["id"] < 0x200)
    # Those of the last cycles may be on their way when it ends; a late answer is logged too.
    assert abs(np.count_nonzero(answers) - 7 * said["cycles"]) <= 7 * 50
    for bus in range(3):
        assert np.all(np.diff(of_loop["t"][of_loop["bus"] == bus]) >= 0.0)


def test_can_utils_read_what_is_exported(recorded: Path, tmp_path: Path) -> None:
    """A frame of candump's format is a line of Vector's, as can-utils makes it."""
    dumped, vector = tmp_path / "run.log", tmp_path / "run.asc"
    assert run(["export", str(recorded), "--to", "candump", "-o", str(dumped)]) == 0
    buses = ("can0", "can1", "can2")
    subprocess.run(["log2asc", "-I", dumped, "-O", vector, *buses], check=True)
    converted = list(can_package.ASCReader(str(vector)))
    exported = list(can_package.CanutilsLogReader(str(dumped)))
    assert len(exported) > 400 * 7 * 2
    assert len(converted) == len(exported)
    for one, other in zip(converted, exported, strict=True):
        assert (one.arbitration_id, bytes(one.data)) == (other.arbitration_id, bytes(other.data))
        assert buses[one.channel] == other.channel


def test_played_back_the_controller_sends_the_same_bits(recorded: Path, tmp_path: Path) -> None:
    code, found, log = play(recorded, tmp_path, *SHORT)
    before, after = load(recorded), load(log)
    assert before.can is not None
    assert after.can is not None
    sent = int(before.can.records["tx"].sum())
    assert found == {
        "equal": True,
        "frames": sent,
        "compared": sent,
        "differing": 0,
        "first_difference": None,
    }
    assert code == 0
    assert sent > 400 * (3 + 7)
    for name in ("q", "tau_cmd", "rho_hat"):
        np.testing.assert_array_equal(after.cycle[name], before.cycle[name])
    for bus in range(3):
        one, other = (can.records[can.records["bus"] == bus] for can in (before.can, after.can))
        assert one.tobytes() == other.tobytes()


def test_with_another_gain_the_first_difference_is_named(recorded: Path, tmp_path: Path) -> None:
    code, found, log = play(recorded, tmp_path, *SHORT, "--set", "control.gains.lam=24.0")
    assert code == 1
    assert found["equal"] is False
    first = found["first_difference"]
    assert isinstance(first, dict)
    assert re.fullmatch(r"0x20[1-7] 0F 00( [0-9A-F]{2}){2}", first["expected"])
    assert first["expected"][:11] == first["found"][:11]
    assert first["expected"] != first["found"]
    # It is the first of all frames of both recordings at which they part.
    before, after = load(recorded).can, load(log).can
    assert before is not None
    assert after is not None
    bus = before.buses.index(first["bus"])
    one, other = (can.records[can.records["bus"] == bus] for can in (before, after))
    count = min(len(one), len(other))
    raw = (records[:count].tobytes() for records in (one, other))
    a, b = (np.frombuffer(each, np.uint8).reshape(count, -1) for each in raw)
    k = int(np.argmax((a != b).any(axis=1)))
    assert one["tx"][k]
    assert (first["t"], first["cycle"]) == (one["t"][k], round(one["t"][k] * 1000))


def test_a_controller_that_leaves_early_is_no_success(recorded: Path, tmp_path: Path) -> None:
    folder = tmp_path / "buses"
    command = (DFTC, "play", recorded, "--bus", "unix", "--bus-dir", folder)
    with started(tmp_path / "player", *command) as player:
        player.until_said("Ctrl-C ends")
        can = load(recorded).can
        assert can is not None
        first = can.records[(can.records["bus"] == 0) & can.records["tx"]][:2]
        node = unix.connect("can0", folder)
        node.send(frames_of(first, 16), 1)
        node.close()
        assert player.end() == 1
        told = player.out.splitlines()
    expected = (
        f"0x{first['id'][1]:03x} {bytes(first['data'][1][: first['length'][1]]).hex(' ').upper()}"
    )
    assert told[0] == f"first difference: set-up, can0: expected {expected}, found none"
    assert re.fullmatch(r"1 of \d+ frames compared, 0 of them differ", told[1])


def test_what_cannot_be_played_is_one_line(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = recorded.read_bytes()
    (tmp_path / "torn.mcap").write_bytes(content[:-1])
    opened = open_session(SCENARIO)
    with opened.recorder(tmp_path / "plain.mcap", 0) as recorder:
        recorder.write_cycles(np.zeros((1, opened.cycle.size)))
    with opened.recorder(tmp_path / "lacks.mcap", 0, with_frames=True) as recorder:
        recorder.write_cycles(np.zeros((1, opened.cycle.size)))
        recorder.write_frames(np.zeros((1, opened.can.size)))
        recorder.write_event(0.5, 2, "recorder", "7 records of ring 'can' dropped: it was full")
    for name, told in (
        ("torn.mcap", "torn, its writer was cut off (expected a whole log; dftc recover"),
        ("plain.mcap", "no topic /can (expected a log that was recorded with --frames)"),
        ("lacks.mcap", "lacks 7 frames that were dropped (expected a whole recording)"),
    ):
        assert run(["play", str(tmp_path / name), "--bus", "unix"]) == 2
        assert capsys.readouterr().err.startswith(f"dftc: {tmp_path / name}: {told}")
    assert run(["play", str(recorded), "--bus", "inprocess"]) == 2
    assert capsys.readouterr().err.startswith("dftc: --bus: 'inprocess' (expected vcan or unix")


def test_interrupted_before_the_end(recorded: Path, tmp_path: Path) -> None:
    command = (DFTC, "play", recorded, "--bus", "unix", "--bus-dir", tmp_path / "buses")
    with started(tmp_path / "player", *command) as player:
        player.until_said("Ctrl-C ends")
        player.process.send_signal(signal.SIGINT)
        assert player.end() == 130
    assert not (tmp_path / "buses").exists()


@pytest.mark.parametrize("profile", ["mit", "moteus"])
def test_other_profiles(profile: str, tmp_path: Path) -> None:
    settings = [f"bus.profile={profile}", "executor.rate_hz=500", "duration_s=0.3", "fault=[]"]
    log, options = tmp_path / "run.mcap", [x for s in settings for x in ("--set", s)]
    assert run(["simulate", SCENARIO, "--frames", "--log", str(log), "--json", *options]) == 0
    code, found, _ = play(log, tmp_path, *options)
    assert (code, found["equal"]) == (0, True), found
