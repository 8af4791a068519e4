"""``dftc control --listen`` beside a rig, before and while somebody controls it."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dftc_rt.cli.main import run
from tests.integration.commands import DFTC, PATIENT, Started, started

pytestmark = pytest.mark.realtime

PANDA = "panda_shoulder_loss"


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Started]:
    arguments = ["rig", PANDA, "--bus", "unix", "--bus-dir", tmp_path / "bus", *PATIENT]
    with started(tmp_path / "rig", DFTC, *arguments) as process:
        process.until_said("Ctrl-C ends")
        yield process


def test_drives_that_wait_and_drives_that_somebody_controls(
    rig: Started, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def listening(*options: str) -> tuple[int, dict[str, Any]]:
        bus = ["--bus", "unix", "--bus-dir", str(tmp_path / "bus")]
        code = run(["control", PANDA, *bus, "--listen", "--duration", "0.5", "--json", *options])
        return code, json.loads(capfd.readouterr().out)

    code, found = listening("--ask")
    assert code == 0, found["against"]
    assert [drive["heard"] for drive in found["drives"]] == [True] * 7
    assert all("is what the robot file says" in drive["said"] for drive in found["drives"])
    arguments = ["control", PANDA, "--bus", "unix", "--bus-dir", tmp_path / "bus", "--no-report"]
    log = ["--log", tmp_path / "run.mcap", "--set", "duration_s=600", "--set", "fault=[]"]
    with started(tmp_path / "control", DFTC, *arguments, *log, *PATIENT) as other:
        other.until_running()
        code, found = listening()
        assert code == 1
        assert other.process.poll() is None  # and was not disturbed
    (line, *_) = found["against"]
    assert line.startswith("can0: somebody else talks to these drives: ")
    assert "SYNC" in line
    can0 = found["buses"][0]
    identifiers = {each["identifier"]: each for each in can0["identifiers"]}
    assert identifiers["0x181"]["what"] == "TPDO1 of panda_joint1"
    assert identifiers["0x080"]["speaker"] == "controller"
    assert abs(identifiers["0x080"]["frames"] - identifiers["0x181"]["frames"]) <= 2
    assert 0.0 < can0["load"] < can0["budget_worst"]
    said = {drive["joint"]: drive["said"] for drive in found["drives"]}
    assert " rad" in said["panda_joint1"]


def test_drives_that_are_set_up_and_no_more(
    rig: Started, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bus = ["--bus", "unix", "--bus-dir", str(tmp_path / "bus")]
    assert run(["control", PANDA, *bus, "--set-up-only", "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert found["ok"] is True
    assert {drive["state"] for drive in found["drives"]} == {"switched on"}
    home = (0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.7)
    for drive, angle in zip(found["drives"], home, strict=True):
        assert abs(drive["position"] - angle) < 0.36  # the reference's amplitude
    rig.process.send_signal(signal.SIGINT)
    assert rig.end() == 0
    assert "served 0 cycles" in rig.out  # no SYNC, so no torque was ever in force
