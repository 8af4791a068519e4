"""``dftc rig`` and ``dftc control`` as two commands."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.log.reader import read
from dftc_rt.rt.supervisor import FOLLOWING
from tests.integration.commands import ATTEMPTS, DFTC, PATIENT, Started, dftc, stalled, started

pytestmark = pytest.mark.realtime

SCENARIO = ("ur5_elbow_loss", "--set", "duration_s=1.0", *PATIENT)


@pytest.fixture(params=["lockstep", "real time"])
def mode(request: pytest.FixtureRequest) -> tuple[str, ...]:
    return ("--lockstep",) if request.param == "lockstep" else ()


@pytest.fixture
def rig(tmp_path: Path, mode: tuple[str, ...]) -> Iterator[Started]:
    bus = ("--bus", "unix", "--bus-dir", tmp_path / "bus", *mode)
    with started(tmp_path / "rig", DFTC, "rig", *SCENARIO, *bus, "--json") as run:
        run.until_said("Ctrl-C ends")
        yield run


def control(folder: Path, log: Path, *more: str) -> tuple[str | Path, ...]:
    return (
        "control", *SCENARIO, "--bus", "unix", "--bus-dir", folder / "bus",
        "--log", log, "--no-report", "--json", *more,
    )  # fmt: skip


def test_end_to_end_twice(rig: Started, mode: tuple[str, ...], tmp_path: Path) -> None:
    for number in (1, 2):  # the rig goes on: a second controller finds the drives as they are
        log = tmp_path / f"{number}.mcap"
        for _ in range(ATTEMPTS):
            done = dftc(*control(tmp_path, log, *mode))
            if done.returncode == 0 or mode or not stalled(log):
                break
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        assert found["end_state"] == "done"
        logged = read(log)
        assert logged.rig is None  # truth is the rig's
        running = np.isin(logged.cycle["state"], FOLLOWING)
        assert running.sum() >= 900
        error = (logged.cycle["q"] - logged.cycle["qd"])[running]
        assert np.abs(error).max() < 0.1
    rig.process.send_signal(signal.SIGINT)
    assert rig.end() == 0
    found = json.loads(rig.out)
    assert found["rig_time_s"] > 2.0
    latency = found["buses"]["can0"]["latency_us"]
    assert 47.0 <= latency["0x080"] < 1000.0  # SYNC: alone, or behind commands in lock-step
    assert {"0x181", "0x201"} <= latency.keys()
    assert not (tmp_path / "bus" / "can0").exists()


def test_a_controller_on_a_python_can_interface(
    rig: Started, mode: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The user-space bus through python-can's plug-in, as an adapter would be reached."""
    monkeypatch.setenv("DFTC_BUS_DIR", str(tmp_path / "bus"))
    buses = ("--bus", "python-can:dftc:can0,can1")
    log = tmp_path / "log.mcap"
    for _ in range(ATTEMPTS):
        done = dftc("control", *SCENARIO, *buses, "--log", log, "--no-report", "--json", *mode)
        if done.returncode == 0 or mode or not stalled(log):
            break
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["end_state"] == "done"
    logged = read(log)
    running = np.isin(logged.cycle["state"], FOLLOWING)
    assert running.sum() >= 900
    assert np.abs((logged.cycle["q"] - logged.cycle["qd"])[running]).max() < 0.1


def test_a_hub_that_is_gone_and_back_ends_the_run_and_serves_the_next(tmp_path: Path) -> None:
    bus = ("--bus", "unix", "--bus-dir", tmp_path / "bus")
    log = tmp_path / "log.mcap"
    told = [part for part in control(tmp_path, log, "--set", "duration_s=60") if part != "--json"]
    with started(tmp_path / "first", DFTC, "rig", *SCENARIO, *bus) as first:
        first.until_said("Ctrl-C ends")
        with started(tmp_path / "control", DFTC, *told) as controller:
            controller.until_running()
            first.process.kill()
            with started(tmp_path / "second", DFTC, "rig", *SCENARIO, *bus) as second:
                second.until_said("Ctrl-C ends")
                assert controller.end() == 1
                assert "bus lost: can" in controller.err or "gone away" in controller.err
                assert "Traceback" not in controller.err
                again = dftc(*control(tmp_path, tmp_path / "again.mcap", "--set", "fault=[]"))
                assert again.returncode == 0, again.stderr
                second.process.send_signal(signal.SIGINT)
                assert second.end() == 0
    assert log.exists()


@pytest.mark.parametrize(
    ("bus", "code", "said"),
    [
        ("python-can:dftc:can0", 2, "names 1 (expected 2, for can0, can1)"),
        ("python-can:dftc", 2, "expected python-can:INTERFACE:CHANNEL"),
        ("python-can:teleport:a,b", 3, "python-can has no interface teleport"),
        ("python-can:dftc:can0,can1", 3, "no rig has this bus open"),
    ],
)
def test_a_python_can_interface_that_cannot_be(
    bus: str, code: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "none").mkdir(mode=0o700)
    monkeypatch.setenv("DFTC_BUS_DIR", str(tmp_path / "none"))
    done = dftc("control", *SCENARIO, "--bus", bus, "--no-report")
    assert done.returncode == code, done.stderr
    assert said in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("mode", [("--lockstep",)], ids=["lockstep"])
def test_directory_in_use_is_refused_with_its_owner(
    rig: Started, mode: tuple[str, ...], tmp_path: Path
) -> None:
    done = dftc("rig", *SCENARIO, "--bus", "unix", "--bus-dir", tmp_path / "bus")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("dftc: ")
    assert done.stderr.count("\n") == 1
    assert str(rig.process.pid) in done.stderr
