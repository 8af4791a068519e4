"""``dftc hil`` with frames that take their time: what fits the bus runs, what does not shows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dftc_rt.bus.bits import nominal_bits
from dftc_rt.log.reader import read
from dftc_rt.log.run import Run
from tests.integration.commands import ATTEMPTS, DFTC, PATIENT, stalled, started

pytestmark = pytest.mark.realtime

RUN = 3.0  # state of a controller that follows its reference


def hil(folder: Path, *settings: str) -> tuple[int, dict[str, Any], Run]:
    """Run two seconds; return exit code, summary and log."""
    command = [
        DFTC, "hil", "ur5_elbow_loss", "--bus", "unix", "--no-report", "--json", *PATIENT,
        "--log", folder / "run.mcap", "--set", "duration_s=2", "--set", "bus.timing=pace",
    ]  # fmt: skip
    for setting in settings:
        command += ["--set", setting]
    for _ in range(ATTEMPTS):
        with started(folder / "run", *command) as run:
            code = run.end()
        if code == 0 or not stalled(folder / "run.mcap"):
            break
    assert "Traceback" not in run.err
    return code, json.loads(run.out), read(folder / "run.mcap")


def test_three_joints_a_bus_fit_and_the_answers_take_their_time(tmp_path: Path) -> None:
    code, found, logged = hil(tmp_path)
    assert code == 0, found
    # SYNC has one byte, TPDO1 eight; nothing can come sooner than their bits allow.
    wire = nominal_bits(1) + 3 * nominal_bits(8)
    # After a cycle without all answers, one of these may be taken for one of the next.
    whole = np.all(logged.cycle["age"] == 0.0, axis=1)
    whole[1:] &= whole[:-1]
    exchange = 1e6 * logged.cycle["exchange"][(logged.cycle["state"] == RUN) & whole]
    assert exchange.min() >= wire
    for bus in found["buses"].values():
        assert bus["dropped"] == bus["malformed"] == 0
        # Three answers are ready together: the last one waits for the others.
        answers = [
            us for can_id, us in bus["latency_us"].items() if 0x181 <= int(can_id, 0) < 0x200
        ]
        assert max(answers) >= 3 * nominal_bits(8)
        assert bus["late_max_us"] >= bus["late_mean_us"] > 0.0


def test_six_joints_a_bus_do_not_fit_and_that_shows(tmp_path: Path) -> None:
    code, found, logged = hil(tmp_path, "robot.joints_per_bus=6", "bus.overload=allow")
    assert code == 1
    assert found["end_state"] == "safe stop"
    assert found["missed_answers"] > 100
    assert logged.rig is not None
    # Commands queue up: each that comes into force is older than the one before.
    assert np.nanmax(logged.rig["cmd_age"]) > 5
    latency = found["buses"]["can0"]["latency_us"]
    assert latency["0x080"] > 10_000  # SYNC waits behind the commands of cycles ago
