"""Faults of processes, host and laws in ``dftc hil``, in real time; what was true is the rig's.

Times are rig time. What the host does to a run on a shared machine proves nothing, so that
the drives' watchdogs and ``stale_cycles`` are patient, and every check is against them.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.integration.commands import WATCHDOG_S, Started
from tests.integration.forked import ForkServer
from tests.integration.survival import (
    CYCLES,
    DEGRADED,
    FAULT,
    LOST_S,
    NAMES,
    PERIOD_S,
    RUN,
    SAFE_STOP,
    SCENARIO,
    arguments,
    leaves_nothing,
    survive,
    to,
)

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def server() -> Iterator[ForkServer]:
    made = ForkServer(SCENARIO, ["fault=[]"])
    yield made
    made.close()


# --- processes ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (signal.SIGKILL, "dftc-controller was killed (SIGKILL)"),
        (signal.SIGSTOP, "dftc-controller made no cycle for 2 s"),
    ],
    ids=["SIGKILL", "SIGSTOP"],
)
def test_a_controller_that_is_gone_leaves_the_drives_to_their_watchdogs(
    server: ForkServer, tmp_path: Path, number: int, says: str
) -> None:
    ended = survive(server, tmp_path, to("dftc-controller", number))
    assert ended.code == 1
    assert says in ended.err
    last = ended.last_command_s()
    # The step that finds the watchdog expired logs what acted until then.
    assert ended.safe_after_s() <= last + WATCHDOG_S + 2.5 * PERIOD_S
    # Nothing else stopped them: heartbeats come every 50 ms, and drives wait for one for 150 ms.
    assert ended.safe_after_s() > last + 0.09


def test_a_controller_that_pauses_finds_its_drives_stopped(
    server: ForkServer, tmp_path: Path
) -> None:
    def pause(run: Started) -> None:
        pid, size = run.children()["dftc-controller"], (tmp_path / "run.mcap").stat().st_size
        os.kill(pid, signal.SIGSTOP)
        # The rig alone fills the log now: half a second of it is twice the watchdog.
        run.until(
            lambda: (
                (tmp_path / "run.mcap").stat().st_size > size + 60_000 or "made no cycle" in run.err
            ),
            "the rig to go on",
        )
        os.kill(pid, signal.SIGCONT)

    ended = survive(server, tmp_path, pause)
    assert ended.code == 1
    assert "the drive reports a fault" in ended.err or "made no cycle" in ended.err
    ended.safe_after_s()


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (signal.SIGKILL, "dftc-rig was killed (SIGKILL)"),
        (signal.SIGSTOP, "no fresh feedback for 250 cycles"),
    ],
    ids=["SIGKILL", "SIGSTOP"],
)
def test_a_rig_that_is_gone_ends_the_run(
    server: ForkServer, tmp_path: Path, number: int, says: str
) -> None:
    ended = survive(server, tmp_path, to("dftc-rig", number), breaks=("short_patience",))
    assert ended.code == 1
    assert says in ended.err
    assert ended.said_its_end()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["SIGKILL", "SIGSTOP"])
def test_a_recorder_that_is_gone_is_replaced_and_loses_little(
    server: ForkServer, tmp_path: Path, number: int
) -> None:
    second = tmp_path / "run.2.mcap"

    def replace(run: Started) -> None:
        os.kill(run.children()["dftc-recorder"], number)
        run.until(lambda: second.exists() and second.stat().st_size > 60_000, "another's log")
        run.process.send_signal(signal.SIGINT)

    ended = survive(server, tmp_path, replace)
    assert ended.code == 130
    assert "dftc-recorder was killed (SIGKILL); another one goes on" in ended.err
    assert np.diff(ended.log.cycle["t"]).max() <= LOST_S
    assert np.diff(ended.rig["t"]).max() <= LOST_S


def test_a_recorder_that_stops_at_the_end_leaves_the_rest_to_another(
    server: ForkServer, tmp_path: Path
) -> None:
    def stop(run: Started) -> None:
        run.process.send_signal(signal.SIGINT)
        os.kill(run.children()["dftc-recorder"], signal.SIGSTOP)

    ended = survive(server, tmp_path, stop, breaks=("short_patience",))
    assert ended.code == 130
    assert any(event.text.startswith("ended: interrupted") for event in ended.log.events)
    assert np.diff(ended.log.cycle["t"]).max() <= LOST_S
    ended.safe_after_s()


def test_a_controller_stopped_in_its_set_up_is_not_waited_for(
    server: ForkServer, tmp_path: Path
) -> None:
    with server.start(tmp_path / "work", arguments(tmp_path, 0.3)) as run:
        run.until(lambda: "dftc-controller" in run.children(), "the controller to start")
        pids = set(run.children().values())
        os.kill(run.children()["dftc-controller"], signal.SIGSTOP)
        assert run.end() == 1
        leaves_nothing(run, pids)
        assert "dftc-controller made no cycle for 2 s" in run.err


def test_a_rig_stopped_in_its_set_up_is_not_waited_for(server: ForkServer, tmp_path: Path) -> None:
    with server.start(tmp_path / "work", arguments(tmp_path, 0.3)) as run:
        run.until(lambda: "dftc-rig" in run.children(), "the rig to start")
        os.kill(run.children()["dftc-rig"], signal.SIGSTOP)
        run.until(lambda: set(run.children()) >= NAMES, "the others to start")
        pids = set(run.children().values())
        assert run.end() == 1
        leaves_nothing(run, pids)
        assert "dftc-rig was stopped for 2 s; it was killed" in run.err


def test_a_rig_that_pauses_in_its_set_up_is_waited_for(server: ForkServer, tmp_path: Path) -> None:
    with server.start(tmp_path / "work", arguments(tmp_path, 0.3)) as run:
        run.until(lambda: "dftc-rig" in run.children(), "the rig to start")
        rig = run.children()["dftc-rig"]
        os.kill(rig, signal.SIGSTOP)
        run.until(lambda: set(run.children()) >= NAMES, "the others to start")
        os.kill(rig, signal.SIGCONT)
        assert run.end() == 0, run.err


@pytest.mark.parametrize("name", sorted(NAMES))
def test_a_process_killed_in_its_set_up_ends_the_run(
    server: ForkServer, tmp_path: Path, name: str
) -> None:
    with server.start(tmp_path / "work", arguments(tmp_path, 0.3)) as run:
        run.until(lambda: name in run.children(), f"{name} to start")
        pids = set(run.children().values())
        os.kill(run.children()[name], signal.SIGKILL)
        code = run.end()
        leaves_nothing(run, pids)
        assert code == (0 if name == "dftc-recorder" else 1), run.err
        assert f"{name} was killed (SIGKILL)" in run.err


# --- the host ----------------------------------------------------------------------------


def test_others_that_take_all_the_time_they_get(server: ForkServer, tmp_path: Path) -> None:
    spin = [sys.executable, "-c", "while True: pass"]
    hogs = [subprocess.Popen(spin) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        ended = survive(server, tmp_path, duration_s=1.0)
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()
    assert ended.code in (0, 1)  # on time, or stopped for not being
    assert ended.said_its_end()
    ended.safe_after_s()


def test_a_full_disk_ends_the_log_and_is_said(server: ForkServer, tmp_path: Path) -> None:
    ended = survive(server, tmp_path, breaks=("disk_full",), duration_s=2.0)
    assert ended.code == 3
    assert "no space left to write" in ended.err
    assert ended.log.cycle["t"].size > 0  # what there was place for can be read
    assert 1 < len(list(tmp_path.glob("run*.mcap"))) <= 5  # so many recorders have tried


def test_a_log_folder_that_is_gone_is_said(server: ForkServer, tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    line = [logs / "run.mcap" if a == tmp_path / "run.mcap" else a for a in arguments(tmp_path, 1)]
    with server.start(tmp_path / "work", line) as run:
        run.until(lambda: set(run.children()) >= NAMES, "the processes to start")
        pids = set(run.children().values())
        run.until(lambda: (logs / "run.mcap").stat().st_size > 60_000, "the run to move")
        shutil.rmtree(logs)
        code = run.end()
        leaves_nothing(run, pids)
        assert code == 1
        assert "no summary: " in run.err
        assert "run.mcap" in run.err


def test_a_clock_that_jumps_is_not_the_clock_of_the_loop(
    server: ForkServer, tmp_path: Path
) -> None:
    ended = survive(server, tmp_path, breaks=("clock_jumps",), duration_s=1.0)
    assert ended.code == 0, ended.err
    t = ended.log.cycle["t"]
    assert np.all(np.diff(t) > 0.0)
    assert t[-1] < 60.0
    assert np.abs(ended.log.cycle["lateness"]).max() < 60.0


def test_one_bus_of_three_that_goes_away(server: ForkServer, tmp_path: Path) -> None:
    ended = survive(server, tmp_path, breaks=("bus_lost",))
    assert ended.code == 1
    assert "safe stop: bus lost: can1" in ended.err
    # Those of the other buses are told; those of this one have their watchdog.
    told = [0, 1, 2, 5, 6]
    moving = (ended.rig["v"][:, told] != 0.0).any(axis=1)
    last = float(ended.rig["t"][np.flatnonzero(moving)[-1]])
    assert last <= ended.log.cycle["t"][-1] + CYCLES * PERIOD_S
    assert ended.safe_after_s() <= ended.log.cycle["t"][-1] + WATCHDOG_S + CYCLES * PERIOD_S


# --- laws --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("breakage", "reason"),
    [
        ("law_nan", "panda_joint4: a value that is not finite"),
        ("law_inf", "panda_joint4: a value that is not finite"),
        ("law_too_much", "panda_joint4: the law asks for more than 87 Nm"),
        ("law_raises", "the law raised ZeroDivisionError: in a law of one's own"),
    ],
)
def test_a_law_that_fails_is_stopped_by_the_drives(
    server: ForkServer, tmp_path: Path, breakage: str, reason: str
) -> None:
    ended = survive(server, tmp_path, breaks=(breakage,))
    assert ended.code == 1
    assert f"safe stop: {reason}" in ended.err
    assert ended.states()[-2:] == [RUN, FAULT]
    assert ended.safe_after_s() <= ended.last_following_s() + CYCLES * PERIOD_S
    assert np.abs(ended.rig["tau_applied"]).max() <= 87.0


@pytest.mark.parametrize("breakage", ["law_slow", "hog_in_the_process"])
def test_a_law_that_takes_five_periods_is_brought_to_rest(
    server: ForkServer, tmp_path: Path, breakage: str
) -> None:
    limit = "supervisor.overruns_in_a_row=20"
    ended = survive(server, tmp_path, breaks=(breakage,), settings=(limit,))
    assert ended.code == 1
    ended.safe_after_s()
    if breakage == "hog_in_the_process" and "made no cycle for 2 s" in ended.err:
        return  # under SCHED_FIFO the thread lets nobody else run
    assert "20 cycles in a row took longer than the period" in ended.err
    assert SAFE_STOP in ended.states()
    took = ended.log.cycle["compute"][np.isin(ended.log.cycle["state"], (RUN, DEGRADED))]
    slow = np.flatnonzero(took > 0.004)
    if breakage == "law_slow":
        assert took.size - slow[0] <= CYCLES + 1  # from the first slow cycle on


# --- the operator ------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_signals_in_set_up_and_twice(server: ForkServer, tmp_path: Path, number: int) -> None:
    with server.start(tmp_path / "work", arguments(tmp_path)) as run:
        run.until(lambda: "dftc-controller" in run.children(), "the controller to start")
        pids = set(run.children().values())
        for _ in range(2):
            run.process.send_signal(number)
        assert run.end() == 130, run.err
        leaves_nothing(run, pids)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_signals_while_it_runs_and_while_it_stops(
    server: ForkServer, tmp_path: Path, number: int
) -> None:
    def twice(run: Started) -> None:
        run.process.send_signal(number)
        run.process.send_signal(number)

    ended = survive(server, tmp_path, twice)
    assert ended.code == 130
    assert ended.err.count("interrupted: stop requested by the operator") == 1
    assert ended.states()[-3:] == [RUN, SAFE_STOP, FAULT]
    ended.safe_after_s()
