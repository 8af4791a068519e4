"""``--json``: one JSON object on stdout with the contract's keys, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from dftc_rt.cli.main import run

# docs/contract.md, "Metrics".
RUN_KEYS = {
    "robot", "law", "ftc", "duration_s", "cycles", "overruns", "lateness_us", "compute_us",
    "exchange_us", "end_state", "reason", "joints",
}  # fmt: skip
QUANTILES = {"p50", "p99", "p999", "max"}
JOINT_KEYS = {
    "rmse_healthy_mrad", "rmse_faulty_mrad", "rmse_twin_mrad", "peak_after_fault_mrad", "rho_rmse",
    "rho_settle_s", "anomaly_delay_s", "detection_delay_s", "false_alarms", "false_alarm_s",
    "torque_rms_nm", "saturated_fraction",
}  # fmt: skip


def answer(capfd: pytest.CaptureFixture[str], *arguments: str | Path) -> dict[str, Any]:
    assert run([*map(str, arguments), "--json"]) == 0
    out, _ = capfd.readouterr()
    assert out.count("\n") == 1
    found = json.loads(out)
    assert isinstance(found, dict)
    return found


def metrics_of_a_run(found: dict[str, Any], joints: int) -> None:
    assert set(found) >= RUN_KEYS
    for name in ("lateness_us", "compute_us", "exchange_us"):
        assert set(found[name]) == QUANTILES
    assert len(found["joints"]) == joints
    assert all(set(joint) == JOINT_KEYS for joint in found["joints"].values())


def test_simulate_then_analyze(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    short = ("--set", "duration_s=2.5", "--set", "fault[0].start_s=1.5")
    simulated = answer(capfd, "simulate", "ur5_elbow_loss", "--log", log, *short)
    metrics_of_a_run(simulated, 6)
    assert simulated["log"] == str(log)
    assert simulated["end_state"] == "done"
    analysed = answer(capfd, "analyze", log)
    metrics_of_a_run(analysed, 6)
    assert analysed["joints"] == simulated["joints"]
    told = ("end_state", "reason", "cycles", "overruns")
    assert [analysed[key] for key in told] == [simulated[key] for key in told]
    assert (analysed["end_state"], analysed["reason"]) == ("done", "")
    assert analysed["joints"]["elbow_joint"]["rmse_faulty_mrad"] > 0


def test_analyze_says_why_a_run_stopped(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log, limit = tmp_path / "run.mcap", "supervisor.tracking_error_rad=0.00002"
    command = ["simulate", "ur5_elbow_loss", "--log", str(log), "--set", limit]
    assert run([*command, "--set", "duration_s=2"]) == 1
    line = capfd.readouterr().err.strip()
    found = answer(capfd, "analyze", log)
    assert found["end_state"] == "safe stop"
    assert "tracking error over 2e-05 rad" in found["reason"]
    assert line == f"dftc: safe stop: {found['reason']}"
    assert run(["analyze", str(log)]) == 0
    out = " ".join(capfd.readouterr().out.split())
    assert f"ended in a safe stop ({found['reason']})" in out


def test_simulate_without_a_log_says_so(capfd: pytest.CaptureFixture[str]) -> None:
    assert answer(capfd, "simulate", "ur5_elbow_loss", "--set", "duration_s=0.1")["log"] is None


def test_doctor(capfd: pytest.CaptureFixture[str]) -> None:
    found = answer(capfd, "doctor")
    assert found["ok"] is True
    assert {"name", "ok", "found", "means", "remedy", "essential"} <= set(found["checks"][0])


def test_robots(capfd: pytest.CaptureFixture[str]) -> None:
    assert {"panda", "ur5"} <= {robot["name"] for robot in answer(capfd, "robots")["robots"]}
