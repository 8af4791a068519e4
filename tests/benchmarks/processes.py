"""Run programs as a user would, each a process of its own, and read the JSON they print."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_PATIENCE_S = 60.0


def read_json(command: Sequence[str | Path], seconds: float) -> dict[str, Any]:
    """Run a program that prints one JSON object.

    Args:
        command: Program and arguments.
        seconds: How long it means to run.

    Raises:
        RuntimeError: It failed; the message holds what it said.
    """
    done = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, check=False,
        timeout=seconds + _PATIENCE_S,
    )  # fmt: skip
    if done.returncode != 0 or not done.stdout:
        raise RuntimeError(f"{command[0]} ended with {done.returncode}: {done.stderr.strip()}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    refused = [
        line for line in done.stderr.splitlines() if "not locked" in line or "no SCHED" in line
    ]
    return found | ({"refused": refused} if refused else {})


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
