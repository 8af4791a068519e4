"""Run programs as a user would, each a process of its own, and read the JSON they print."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_PATIENCE_S = 60.0


def read_json(
    command: Sequence[str | Path], seconds: float, said: Path | None = None
) -> dict[str, Any]:
    """Run a program that prints one JSON object.

    Args:
        command: Program and arguments.
        seconds: How long it means to run.
        said: File for what it says on stderr, for who wants to read it meanwhile.

    Raises:
        RuntimeError: It failed or printed nothing; the message holds what it said. A run
            that ended in a safe stop (exit code 1) has a summary and is no failure here.
    """
    with contextlib.ExitStack() as files:
        diagnostics = subprocess.PIPE if said is None else files.enter_context(said.open("w"))
        begun = subprocess.Popen(
            [str(part) for part in command], stdout=subprocess.PIPE, stderr=diagnostics, text=True
        )
    seen: dict[str, str] = {}
    deadline = time.monotonic() + seconds + _PATIENCE_S
    while True:
        try:
            out, err = begun.communicate(timeout=0.5)
            break
        except subprocess.TimeoutExpired:
            seen |= _scheduling(begun.pid)
            if time.monotonic() > deadline:
                begun.terminate()  # dftc hil stops safely and ends its children
                raise RuntimeError(
                    f"{command[0]} did not end in {seconds + _PATIENCE_S} s"
                ) from None
    if begun.returncode not in (0, 1) or not out:
        raise RuntimeError(f"{command[0]} ended with {begun.returncode}: {(err or '').strip()}")
    found: dict[str, Any] = json.loads(out.splitlines()[-1])
    return found | {"scheduling": [f"{name}: {how}" for name, how in sorted(seen.items())]}


def _scheduling(parent: int) -> dict[str, str]:
    """Return how the children of a process are scheduled, by name."""
    found: dict[str, str] = {}
    with contextlib.suppress(OSError):  # what has just ended is of no interest
        for pid in map(int, Path(f"/proc/{parent}/task/{parent}/children").read_text().split()):
            name = Path(f"/proc/{pid}/comm").read_text().strip()
            policy, cores = os.sched_getscheduler(pid), os.sched_getaffinity(pid)
            fifo = f"SCHED_FIFO {os.sched_getparam(pid).sched_priority}"
            where = ", ".join(map(str, sorted(cores)))
            found[name] = f"{fifo if policy == os.SCHED_FIFO else 'normal'}, core {where}"
    return found


def hil(scenario: str, seconds: float, settings: Sequence[str], folder: Path) -> dict[str, Any]:
    """Run ``dftc hil`` on the user-space bus in real time; return its summary.

    Args:
        scenario: Name of a shipped scenario.
        seconds: Length of the run.
        settings: Further overrides, ``key=value``.
        folder: Where the log goes.
    """
    command: list[str | Path] = [
        Path(sys.executable).parent / "dftc", "hil", scenario, "--bus", "unix", "--json",
        "--no-report", "--log", folder / "run.mcap", "--set", f"duration_s={seconds}",
    ]  # fmt: skip
    for setting in settings:
        command += ["--set", setting]
    return read_json(command, seconds)


def pingpong(style: str, nodes: Sequence[int], seconds: float) -> dict[str, Any]:
    """Run the floor of the exchange."""
    command = [
        sys.executable, "-m", "tests.benchmarks.pingpong", "--style", style,
        "--seconds", str(seconds), "--nodes", *map(str, nodes),
    ]  # fmt: skip
    return read_json(command, seconds)
