"""``dftc hil`` in real time: what it leaves, how it is stopped, and what survives a kill."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.log.reader import read
from dftc_rt.log.run import Run
from tests.integration.commands import (
    ATTEMPTS,
    DFTC,
    PATIENT,
    WATCHDOG_S,
    Started,
    attachments,
    dftc,
    gone,
    stalled,
    started,
    topics,
    until,
)

pytestmark = pytest.mark.realtime

NAMES = {"dftc-controller", "dftc-rig", "dftc-recorder"}
PERIOD_S = 0.001


def hil(folder: Path, duration_s: float) -> tuple[str | Path, ...]:
    return (
        DFTC, "hil", "ur5_elbow_loss", "--bus", "unix", "--no-report", *PATIENT,
        "--set", f"duration_s={duration_s}", "--log", folder / "run.mcap",
    )  # fmt: skip


@pytest.fixture
def long(tmp_path: Path) -> Iterator[Started]:
    """A run that lasts until something ends it."""
    with started(tmp_path / "run", *hil(tmp_path, 600)) as run:
        run.until_running()
        yield run


def leaves_nothing(run: Started, pids: list[int]) -> None:
    """No process, no bus directory, no named shared memory."""
    until(lambda: all(gone(pid) for pid in pids), "the children to end")
    until(lambda: not list(run.folder.glob("dftc-*")), "the bus directory to go")
    assert not [p for p in Path("/dev/shm").glob("*dftc*") if p.stat().st_uid == os.getuid()]


def off_after(run: Run, last_command_s: float, brake_s: float = 0.0) -> None:
    """Torque is off and brakes are closed a watchdog later, in rig time, and stay so.

    Drives that let go give the brakes ``brake_s`` more.
    """
    assert run.rig is not None
    t, v, tau = run.rig["t"], run.rig["v"], run.rig["tau_applied"]
    # The step that finds the watchdog expired logs what acted until then.
    late = np.flatnonzero(t > last_command_s + WATCHDOG_S + brake_s + PERIOD_S)[1:]
    assert late.size > 0
    assert np.all(tau[late] == 0.0)
    assert np.all(v[late] == 0.0)
    assert np.all(run.rig["q"][late] == run.rig["q"][late[0]])


def test_three_seconds_leave_a_whole_log(tmp_path: Path) -> None:
    for _ in range(ATTEMPTS):
        with started(tmp_path / "run", *hil(tmp_path, 3), "--json") as run:
            run.until(lambda: set(run.children()) >= NAMES, "the processes to start")
            pids = list(run.children().values())
            code = run.end()
            leaves_nothing(run, pids)
        if code == 0 or not stalled(tmp_path / "run.mcap"):
            break
    assert code == 0, run.err
    found = json.loads(run.out)
    assert found["end_state"] == "done"
    assert found["logs"] == [str(tmp_path / "run.mcap")]
    assert set(found["buses"]) == {"can0", "can1"}
    log = tmp_path / "run.mcap"
    assert topics(log) >= {
        "/cycle", "/rig", "/joint_states", "/tf", "/robot_description", "/events",
    }  # fmt: skip
    kept = attachments(log)
    assert b"duration_s = 3" in kept["scenario.toml"]
    assert b"torque_lag_s = 0.001" in kept["scenario.toml"]  # resolved: defaults written out
    logged = read(log)
    assert logged.cycle["t"].size == found["cycles"]
    assert {7.0, 6.0} < set(logged.cycle["state"])
    assert [e.text for e in logged.events if e.source == "controller"][:2] == ["arming", "running"]


def test_rig_that_starts_slowly_is_waited_for(tmp_path: Path) -> None:
    # On a fresh machine the rig compiles its kernels for many seconds.
    slow = (
        "import sys, time\n"
        "import dftc_rt.cli.hil as hil\n"
        "from dftc_rt.cli.main import main\n"
        "make = hil.make_rig\n"
        "hil.make_rig = lambda *a: (time.sleep(2.0), make(*a))[1]\n"
        "main(sys.argv[1:])\n"
    )
    _, *arguments = hil(tmp_path, 0.2)
    with started(tmp_path / "run", sys.executable, "-c", slow, *arguments) as run:
        code = run.end()
    assert code == 0 or stalled(tmp_path / "run.mcap"), run.err  # it ran, either way


def test_sigint_is_a_safe_stop(long: Started, tmp_path: Path) -> None:
    pids = list(long.children().values())
    long.process.send_signal(signal.SIGINT)
    assert long.end() == 130
    assert "interrupted: stop requested by the operator" in long.err
    assert "Traceback" not in long.err
    leaves_nothing(long, pids)
    logged = read(tmp_path / "run.mcap")
    assert 5.0 in logged.cycle["state"]  # came to rest under control
    assert logged.rig is not None
    assert np.all(logged.rig["tau_applied"][-1] == 0.0)
    assert np.all(logged.rig["v"][-1] == 0.0)


def test_killed_controller_leaves_the_drives_to_their_watchdogs(
    long: Started, tmp_path: Path
) -> None:
    pids = long.children()
    os.kill(pids["dftc-controller"], signal.SIGKILL)
    assert long.end() == 1
    assert long.err.count("dftc-controller was killed (SIGKILL)") == 1
    assert "Traceback" not in long.err
    leaves_nothing(long, list(pids.values()))
    logged = read(tmp_path / "run.mcap")
    assert logged.rig is not None
    fresh = logged.rig["cmd_age"][:, 0] == 1.0
    last = float(logged.rig["t"][fresh][-1])
    assert np.any(logged.rig["tau_applied"][fresh][-1] != 0.0)
    off_after(logged, last)


def test_killed_recorder_is_replaced(long: Started, tmp_path: Path) -> None:
    pids = long.children()
    first, second = tmp_path / "run.mcap", tmp_path / "run.2.mcap"
    long.until(lambda: first.stat().st_size > 100_000, "the recorder's log")
    os.kill(pids["dftc-recorder"], signal.SIGKILL)
    long.until(lambda: second.exists() and second.stat().st_size > 100_000, "another's log")
    everybody = [*pids.values(), *long.children().values()]
    long.process.send_signal(signal.SIGINT)
    assert long.end() == 130
    assert "another one goes on" in long.err
    assert "interrupted: stop requested by the operator" in long.err
    leaves_nothing(long, everybody)
    assert dftc("recover", tmp_path / "run.mcap", "-o", tmp_path / "whole.mcap").returncode == 0
    before, after = read(tmp_path / "whole.mcap").cycle["t"], read(second).cycle["t"]
    assert before[-1] < after[0]
    assert after[-1] > after[0] + 0.3


def test_killed_launcher_takes_the_rest_with_it(long: Started, tmp_path: Path) -> None:
    pids = long.children()
    assert set(pids) >= NAMES
    long.process.kill()
    long.end()
    leaves_nothing(long, list(pids.values()))
    logged = read(tmp_path / "run.mcap")
    assert 5.0 in logged.cycle["state"]
    assert logged.cycle["state"][-1] == 6.0
    assert logged.rig is not None
    assert np.all(logged.rig["tau_applied"][-1] == 0.0)


def test_controller_and_rig_share_a_core_in_real_time_or_say_why_not(long: Started) -> None:
    pids = long.children()
    loops = [pids["dftc-controller"], pids["dftc-rig"]]
    permitted = os.geteuid() == 0
    if permitted:
        assert [os.sched_getscheduler(pid) for pid in loops] == [os.SCHED_FIFO] * 2
        cores = [os.sched_getaffinity(pid) for pid in loops]
        assert cores[0] == cores[1]
        assert len(cores[0]) == 1
    assert os.sched_getscheduler(pids["dftc-recorder"]) == os.SCHED_OTHER
    long.process.send_signal(signal.SIGINT)
    assert long.end() == 130
    assert ("no SCHED_FIFO" in long.err) == (not permitted)


def test_a_closed_terminal_is_a_safe_stop(long: Started) -> None:
    pids = list(long.children().values())
    long.process.send_signal(signal.SIGHUP)
    assert long.end() == 130
    until(lambda: all(gone(pid) for pid in pids), "the children to end")
