"""``dftc replay``: what the controller did, again from its log alone."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dftc_rt.analysis.metrics import evaluate
from dftc_rt.cli.main import run as command
from dftc_rt.cli.session import ending, open_session
from dftc_rt.controller import connect
from dftc_rt.errors import LogError
from dftc_rt.log.reader import read
from dftc_rt.log.run import Run
from dftc_rt.memory import MemorySink
from dftc_rt.replay.compare import Comparison, compare
from dftc_rt.replay.loop import replay
from dftc_rt.replay.stored import controller_of
from dftc_rt.ring import Event
from dftc_rt.rt.clock import FakeClock
from hil.simulate import in_process_rig
from tests.integration.commands import DFTC, dftc, started

ARM2 = "paper_example2_urdf"
LOSS = 'fault=[{kind="loss", joint="joint1", start_s=0.4, effectiveness=0.5}]'
SHORT = ("duration_s=1.0", LOSS)


def simulated(path: Path, *settings: str, scenario: str = ARM2) -> Path:
    """Log a simulation; how it ends is the test's affair."""
    options = [word for setting in settings for word in ("--set", setting)]
    assert command(["simulate", scenario, "--log", str(path), "--json", *options]) in (0, 1)
    return path


def calibration(path: Path, torque_constant: float) -> Path:
    """A calibration of the arm that is not its truth."""
    joints = "".join(
        f'[[joint]]\nname = "{name}"\narmature = 0.1\ntorque_constant = {torque_constant}\n'
        for name in ("joint1", "joint2")
    )
    link = (
        '[[link]]\njoint = "joint2"\nmass_kg = 2.0\nfirst_moment_kg_m = [0.0, 0.0, 1.0]\n'
        "inertia_kg_m2 = [0.7, 0.0, 0.7, 0.0, 0.0, 0.01]\n"
    )
    path.write_text(f'format = 1\nrobot = "arm2"\n{link}{joints}')
    return path


def again(run: Run, *settings: str) -> Comparison:
    return compare(run, replay(controller_of(run, settings), run))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("log") / "run.mcap", *SHORT)


@pytest.fixture
def logged(log: Path) -> Run:
    return read(log)


# -- to the last bit ----------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        ("control.interconnection=measured",),
        ("control.interconnection=frozen", "control.gains.observer=gradient"),
        ("control.local_terms=tabulated",),
        ("bus.profile=mit",),
        ("bus.profile=moteus",),
        ("control.law=computed_torque",),
        ("control.law=momentum",),
        ("control.law=eso",),
        ("control.law=adaptive",),
        ("control.law=oracle",),
        ('fault=[{kind="frame_loss", bus="can0", probability=0.1}]',),
        ('fault=[{kind="emcy", joint="joint2", start_s=0.3, error_code=4096}]',),
        ('fault=[{kind="silent", joint="joint2", start_s=0.3}]',),
        ("control.gains.attribution=hypotheses", "control.gains.threshold_anomaly=2"),
        ("supervisor.rho_min=0.8",),
    ],
    ids=lambda settings: settings[0][:40],
)
def test_every_kind_of_run_is_replayed(settings: tuple[str, ...], tmp_path: Path) -> None:
    logged = read(simulated(tmp_path / "run.mcap", *SHORT, *settings))
    assert len(logged.cycle["t"]) > 300
    found = again(logged)
    assert found.first is None
    assert found.cycles == found.logged
    # What was set anew to what it was is replayed as it was.
    found = again(logged, "control.ftc=true")
    assert found.first is None


def test_another_robot_another_plant_and_the_papers_law(tmp_path: Path) -> None:
    panda = simulated(tmp_path / "panda.mcap", "duration_s=0.5", scenario="panda_shoulder_loss")
    paper = simulated(tmp_path / "paper.mcap", "duration_s=0.5", scenario="paper_example1")
    for path in (panda, paper):
        assert again(read(path)).first is None


@pytest.mark.realtime
def test_a_run_in_real_time_is_replayed(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    lost = 'fault=[{kind="frame_loss", bus="can0", probability=0.02}]'
    options = ("--log", path, "--no-report", "--set", "duration_s=1.5", "--set", lost)
    dftc("hil", ARM2, *options)  # on a busy machine it may end in a safe stop: replayed as well
    done = dftc("replay", path)
    assert done.returncode == 0, done.stdout
    assert "equal to the last bit; the end too" in done.stdout
    assert read(path).cycle["age"].max() > 0


# -- ticks without a cycle, cycles that are not in the log --------------------------------


def late(
    settings: tuple[str, ...],
    delays: dict[int, float],
    path: Path,
    wrong: dict[int, str] | None = None,
    emergency: dict[int, int] | None = None,
) -> Run:
    """A run on a clock of which some ticks are late, by so many periods; from its log.

    Args:
        settings: Of the scenario.
        delays: By cycle; that of -1 is the cycle in which the operator stops the run.
        path: Of the log.
        wrong: By cycle, what is wrong with a bus from then on.
        emergency: By cycle, the joint whose drive sends one.
    """
    opened = open_session(ARM2, settings)
    clock, events, stopped = FakeClock(), [], int(delays.pop(-1, 1e9))
    clock.lockstep = True  # the link's exchange ends with the rig's barrier
    period = 1e9 / opened.scenario.executor.rate_hz
    clock.delays = [round(delays.get(k, 0.0) * period) for k in range(5000)]
    cycles, truth = MemorySink(opened.cycle.size), MemorySink(opened.rig.size)
    motion = np.empty((3, opened.robot.n))
    opened.parts.reference.target(0.0, motion)

    def event(*given: Any) -> None:
        events.append(Event(*given))

    joined = in_process_rig(opened.scenario, opened.robot, motion, truth, event)
    executor = connect(
        opened.scenario, opened.parts, joined.sockets, clock, cycles, event,
        lambda: len(cycles) >= stopped,
    )  # fmt: skip
    clock.lockstep = False  # the executor's own overruns count
    link, exchange = executor._link, executor._link.exchange

    def meet(number: int, deadline: int) -> None:
        exchange(number, deadline)
        link.fault = link.fault or (wrong or {}).get(number, "")
        if number in (emergency or {}):
            link.emergency[(emergency or {})[number]] = 0x8130

    link.exchange = meet  # type: ignore[method-assign]
    outcome = executor.run()
    event(executor.t, 1, "controller", ending(outcome))
    with opened.recorder(path, 0) as recorder:
        for each in events:
            recorder.write_event(*each)
        recorder.write_cycles(cycles.records())
    return read(path)


@pytest.mark.parametrize("policy", ["skip", "catch_up", "stop"])
def test_late_ticks_are_as_late_again(policy: str, tmp_path: Path) -> None:
    delays = {500: 1.5, 700: 3.2, 710: 1.1}
    logged = late((*SHORT, f"executor.overrun={policy}"), delays, tmp_path / "run.mcap")
    assert logged.cycle["overruns"][-1] > 0
    assert (logged.cycle["skipped"][-1] > 0) == (policy != "catch_up")
    assert ("safe stop" in logged.events[-1].text) == (policy == "stop")
    assert again(logged).first is None


def test_a_gap_that_is_no_skip_is_of_lost_cycles(tmp_path: Path) -> None:
    logged = late(SHORT, {500: 3.5}, tmp_path / "run.mcap")
    logged.cycle["skipped"][:] = 0.0
    found = again(logged)
    assert found.first is None
    assert found.cycles < found.logged


def test_the_operators_stop_is_replayed(tmp_path: Path) -> None:
    logged = late(SHORT, {-1: 800}, tmp_path / "run.mcap")
    assert "stop requested by the operator" in logged.events[-1].text
    assert again(logged).first is None


@pytest.mark.parametrize("cycle", [5, 800], ids=["arming", "running"])
def test_what_was_wrong_with_a_bus_is_replayed(cycle: int, tmp_path: Path) -> None:
    wrong = "can0: bus-off, as if nobody acknowledged"
    logged = late(SHORT, {}, tmp_path / "run.mcap", {cycle: wrong})
    assert f"; {wrong}" in logged.events[-1].text
    found = again(logged)
    assert found.first is None
    assert found.cycles == found.logged
    silent = [event for event in logged.events if not event.text.startswith("quick stop")]
    assert again(dataclasses.replace(logged, events=silent)).first is not None


def test_an_emergency_of_a_drive_that_goes_on_is_replayed(tmp_path: Path) -> None:
    """Its statusword says nothing of it."""
    logged = late(SHORT, {}, tmp_path / "run.mcap", emergency={700: 1})
    assert "joint2: the drive sent an emergency" in logged.events[-1].text
    found = again(logged)
    assert found.first is None
    assert found.cycles == found.logged


def test_cycles_that_the_recorder_lost_end_the_replay(logged: Run, tmp_path: Path) -> None:
    kept = np.delete(np.arange(len(logged.cycle["t"])), slice(700, 740))
    cut = dataclasses.replace(logged, cycle={k: v[kept] for k, v in logged.cycle.items()})
    found = again(cut)
    assert found.first is None
    assert (found.cycles, found.logged) == (700, len(kept))
    headless = {name: rows[3:] for name, rows in logged.cycle.items()}
    with pytest.raises(LogError, match="begins with cycle 3"):
        again(dataclasses.replace(logged, cycle=headless))


def test_torn_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = simulated(tmp_path / "run.mcap", "duration_s=5.0", LOSS)  # of several chunks
    capsys.readouterr()
    torn, whole = tmp_path / "torn.mcap", tmp_path / "whole.mcap"
    torn.write_bytes(log.read_bytes()[: int(0.6 * log.stat().st_size)])
    assert command(["replay", str(torn)]) == 2
    assert "dftc recover" in capsys.readouterr().err
    assert command(["recover", str(torn), "-o", str(whole)]) == 0
    assert command(["replay", str(whole)]) == 0
    assert "before its run did" in capsys.readouterr().out


@pytest.mark.realtime
def test_a_run_in_two_files(tmp_path: Path) -> None:
    long = ("--no-report", "--log", tmp_path / "run.mcap", "--set", "duration_s=60")
    with started(tmp_path / "cwd", DFTC, "hil", ARM2, *long) as process:
        process.until_running()
        first, second = tmp_path / "run.mcap", tmp_path / "run.2.mcap"
        process.until(lambda: first.stat().st_size > 100_000, "the recorder's log")
        os.kill(process.children()["dftc-recorder"], signal.SIGKILL)
        process.until(lambda: second.exists() and second.stat().st_size > 50_000, "another's")
        process.process.send_signal(signal.SIGINT)
        process.end()
    done = dftc("replay", first, second, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["equal"]
    assert found["cycles"] > 100
    alone = dftc("replay", second)
    assert alone.returncode == 2
    assert "from its first cycle on" in alone.stderr


def test_files_of_two_runs_are_not_one(log: Path, tmp_path: Path, capsys: Any) -> None:
    other = simulated(tmp_path / "other.mcap", "duration_s=0.2", "seed=2")
    assert command(["replay", str(log), str(other)]) == 2
    assert "is of another run" in capsys.readouterr().err


# -- what is not so any more --------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "expected"), [("v", "rho_hat"), ("tau_cmd", "tau_cmd"), ("verdict", "verdict")]
)
def test_one_changed_value_is_found(logged: Run, name: str, expected: str) -> None:
    logged.cycle[name][600, 1] += 0.001
    found = again(logged).first
    assert found is not None
    assert (found.cycle, found.joint, found.signal) == (600, "joint2", expected)


def test_another_threshold_is_found_and_told(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = read(log)
    changed = run.scenario.replace("[control.gains]", "[control.gains]\nthreshold_loss = 40.0")
    assert changed != run.scenario
    found = again(dataclasses.replace(run, scenario=changed)).first
    assert found is not None
    assert found.joint == "joint1"
    assert found.t > 0.4  # from the loss on


def test_the_files_that_a_scenario_named_may_be_gone(tmp_path: Path) -> None:
    motion, gone = tmp_path / "motion.csv", tmp_path / "gone.csv"
    motion.write_text("t,q1,q2\n0,0.5,0.3\n1,0.6,0.2\n2,0.5,0.3\n")
    given = calibration(tmp_path / "arm2.toml", 1.03)
    settings = (
        "duration_s=0.5", "fault=[]", f"control.calibration={given}",
        f"reference={{kind='csv', file='{motion}'}}",
    )  # fmt: skip
    logged = read(simulated(tmp_path / "run.mcap", *settings))
    motion.rename(gone)
    given.write_text("nothing of the kind")
    assert again(logged).first is None
    assert {"robot.toml", "calibration.toml", "reference.csv"} <= set(logged.attachments)
    lacking = {k: v for k, v in logged.attachments.items() if k != "calibration.toml"}
    with pytest.raises(LogError, match=r"no attachment calibration\.toml"):
        again(dataclasses.replace(logged, attachments=lacking))


def test_a_log_of_an_earlier_version_is_refused(logged: Run) -> None:
    with pytest.raises(LogError, match=r"no attachment robot\.toml"):
        again(dataclasses.replace(logged, attachments={}))
    logged.cycle.pop("status")
    with pytest.raises(LogError, match="no field status"):
        again(logged)


# -- what would have been -----------------------------------------------------------------


def test_other_settings(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "other.mcap"
    asked = ["--set", "control.gains.threshold_loss=[40, 15]"]
    capsys.readouterr()
    assert command(["replay", str(log), *asked, "-o", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    one, other = (found["joints"]["joint1"][which] for which in ("logged", "replayed"))
    assert one["verdict"] == other["verdict"] == 1
    assert other["attributed_s"] > one["attributed_s"]
    assert found["other_command_s"] == pytest.approx(one["attributed_s"], abs=0.01)
    assert found["other_command_joint"] == "joint1"
    same = found["joints"]["joint2"]
    assert same["logged"] == same["replayed"]
    # Its log is one like any other, but for a replay.
    metrics = evaluate(read(out))["joints"]["joint1"]
    before = evaluate(read(log))["joints"]["joint1"]
    assert metrics["detection_delay_s"] > before["detection_delay_s"]
    assert command(["report", str(out), "-o", str(tmp_path / "other.html")]) == 0
    assert command(["replay", str(out)]) == 2
    assert "replay --set" in capsys.readouterr().err


def test_the_answer_is_the_same_as_of_a_run_up_to_the_first_other_command(
    log: Path, tmp_path: Path
) -> None:
    """An open-loop answer is a true one as long as no command differs."""
    asked = "control.gains.threshold_loss=[40, 15]"
    run, ran = read(log), read(simulated(tmp_path / "ran.mcap", *SHORT, asked))
    replayed = replay(controller_of(run, [asked]), run)
    parts = ~(run.cycle["tau_cmd"] == ran.cycle["tau_cmd"]).all(axis=1)
    first = int(np.flatnonzero(parts)[0])
    assert first > 400  # from the loss on
    for name in ("rho_hat", "verdict", "residual", "tau_cmd"):
        np.testing.assert_array_equal(replayed.cycle[name][:first], ran.cycle[name][:first])


def test_a_stop_that_would_have_been_ends_the_replay(log: Path, capsys: Any) -> None:
    assert command(["replay", str(log), "--set", "supervisor.rho_min=0.8"]) == 0
    out = capsys.readouterr().out
    assert "the replay ends in a safe stop: joint1: estimated effectiveness below 0.8" in out


def test_a_stop_that_would_not_have_been_does_too(tmp_path: Path, capsys: Any) -> None:
    path = simulated(tmp_path / "run.mcap", *SHORT, "supervisor.rho_min=0.8")
    capsys.readouterr()
    assert command(["replay", str(path)]) == 0
    assert "safe stop (joint1: estimated effectiveness below 0.8)" in capsys.readouterr().out
    assert command(["replay", str(path), "--set", "supervisor.rho_min=0.1"]) == 0
    assert "with these settings it goes on" in capsys.readouterr().out


def test_another_torque_constant_changes_what_a_command_meant(log: Path, tmp_path: Path) -> None:
    one, other = calibration(tmp_path / "a.toml", 1.0), calibration(tmp_path / "b.toml", 1.1)
    run = read(log)
    reference = controller_of(run, [f"control.calibration={one}"])
    stored = controller_of(run, [f"control.calibration={other}"])
    assert stored.units.tolist() == [1.1, 1.1]
    before = replay(reference, run).cycle["rho_hat"][600, 0]
    after = replay(stored, run).cycle["rho_hat"][600, 0]
    assert after == pytest.approx(before / 1.1, rel=0.05)  # the same motion of more torque
