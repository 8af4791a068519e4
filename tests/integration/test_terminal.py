"""``dftc hil`` on a terminal: the table, and what is left of it."""

from __future__ import annotations

import os
import pty
import subprocess
import time
from pathlib import Path

import pytest

from tests.integration.commands import ATTEMPTS, DEADLINE_S, DFTC, PATIENT

pytestmark = pytest.mark.realtime


def on_terminal(*arguments: str | Path) -> tuple[int, str]:
    """Run ``dftc`` with a terminal as its standard error; return exit code and what it got."""
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
    process = subprocess.Popen(
        [DFTC, *map(str, arguments)],
        stdin=theirs, stdout=subprocess.DEVNULL, stderr=theirs, env=environment,
    )  # fmt: skip
    os.close(theirs)
    got, deadline = b"", time.monotonic() + DEADLINE_S
    try:
        while time.monotonic() < deadline:
            try:
                block = os.read(ours, 65536)
            except OSError:  # the other end has been closed
                break
            if not block:
                break
            got += block
        return process.wait(DEADLINE_S), got.decode()
    finally:
        process.kill()
        os.close(ours)


def test_a_terminal_gets_a_table_that_goes_with_the_run(tmp_path: Path) -> None:
    for _ in range(ATTEMPTS):
        code, got = on_terminal(
            "hil", "ur5_elbow_loss", "--bus", "unix", "--no-report", *PATIENT,
            "--set", "duration_s=3", "--set", "fault[0].start_s=1", "--log", tmp_path / "r.mcap",
        )  # fmt: skip
        if code == 0:
            break
    assert code == 0, got
    tables = got.count("elbow_joint")
    assert 4 <= tables <= 20  # at most five a second
    assert "\x1b[2K" in got  # each takes the place of the one before
    assert "█" in got
    assert "actuator loss" in got
    assert "cycles/s" in got
    assert "bus load: can0" in got
    assert "planned" not in got.rpartition("bus load")[2]  # the rig has counted
    assert "worst error" not in got  # no plain lines between


def test_a_pipe_gets_plain_lines(tmp_path: Path) -> None:
    done = subprocess.run(
        [DFTC, "hil", "ur5_elbow_loss", "--bus", "unix", "--no-report", *PATIENT,
         "--set", "duration_s=2", "--log", tmp_path / "r.mcap"],
        capture_output=True, text=True, timeout=DEADLINE_S,
    )  # fmt: skip
    lines = [line for line in done.stderr.splitlines() if line.startswith("t ")]
    assert lines, done.stderr
    assert "worst error" in lines[0]
    assert "\x1b" not in done.stderr
