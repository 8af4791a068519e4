"""Bad usage and bad input: exit code 2, one line on stderr, nothing on stdout."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from dftc_rt.cli.main import run

PANDA = "panda_shoulder_loss"
Lines = pytest.CaptureFixture[str]


def refused(arguments: list[str], capfd: Lines, code: int = 2) -> str:
    """Run a command that must be refused; return its one line."""
    assert run(arguments) == code
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("dftc: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    return err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["bogus"], "bogus"),
        (["simulate"], "scenario"),
        (["simulate", PANDA, "--nope"], "--nope"),
        (["simulate", "nowhere.toml"], "nowhere.toml"),
        (["simulate", "nowhere"], PANDA),
        (["simulate", PANDA, "--set", "bogus.x=1"], "bogus"),
        (["simulate", PANDA, "--set", "control.gain=1"], "control.gain"),
        (["simulate", PANDA, "--set", "duration_s=-1"], "duration_s"),
        (["simulate", PANDA, "--set", 'duration_s="long"'], "duration_s"),
        (["simulate", PANDA, "--set", "control.ftc=3"], "control.ftc"),
        (["simulate", PANDA, "--set", "control.law=nonsense"], "nonsense"),
        (["simulate", PANDA, "--set", "fault[0].joint=knee"], "knee"),
        (["simulate", PANDA, "--set", "fault[0].kind=nonsense"], "fault[0].kind"),
        (["simulate", PANDA, "--set", "fault[0].end_s=1"], "fault[0].end_s"),
        (["simulate", PANDA, "--set", "robot.name=nobody"], "nobody"),
        (["simulate", PANDA, "--set", "robot.urdf=some.urdf"], "robot"),
        (["simulate", PANDA, "--set", "rig.plant.viscous=[1.0, 2.0]"], "rig.plant.viscous"),
        (["simulate", PANDA, "--set", "rig.plant.q0_rad=[1.0]"], "rig.plant.q0_rad"),
        (["simulate", PANDA, "--set", "reference.amplitude_rad=3.0"], "panda_joint"),
        (["simulate", PANDA, "--set", "bus.bitrate=500000"], "can0"),
        (["hil", PANDA, "--bus", "nonsense"], "nonsense"),
        (["hil", PANDA, "--set", "fault[0].joint=knee"], "knee"),
        (["control", PANDA], "--bus"),
        (["control", PANDA, "--bus", "nonsense"], "nonsense"),
        (["control", PANDA, "--bus", "socketcan:can0"], "can0"),
        (["control", PANDA, "--bus", ""], "''"),
        (["hil", PANDA, "--bus", ""], "''"),
        (["rig", PANDA, "--bus", ""], "''"),
        (["rig", PANDA, "--bus", "inprocess"], "inprocess"),
        (["analyze", "nowhere.mcap"], "nowhere.mcap"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_bad_usage(
    arguments: list[str],
    words: str,
    capfd: Lines,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert words in refused(arguments, capfd)
    assert list(tmp_path.iterdir()) == []  # what is refused leaves nothing behind


def test_bad_toml_names_file_and_line(capfd: Lines, tmp_path: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text('name = "x"\nduration_s = = 3\n')
    line = refused(["simulate", str(bad)], capfd)
    assert str(bad) in line
    assert "line 2" in line


@pytest.mark.parametrize("command", ["simulate", "hil"])
def test_log_that_cannot_be_written(command: str, capfd: Lines, tmp_path: Path) -> None:
    assert str(tmp_path) in refused([command, PANDA, "--log", str(tmp_path)], capfd)
    # Below a file, so that it holds for root as well.
    (tmp_path / "file").touch()
    log = tmp_path / "file" / "run.mcap"
    assert str(tmp_path / "file") in refused([command, PANDA, "--log", str(log)], capfd)


def test_an_unsafe_bus_directory(capfd: Lines, tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    arguments = ["control", PANDA, "--bus", "unix", "--bus-dir", str(tmp_path)]
    assert "0755" in refused(arguments, capfd)


def test_directory_as_a_log_is_refused_by_the_readers(capfd: Lines, tmp_path: Path) -> None:
    assert str(tmp_path) in refused(["analyze", str(tmp_path)], capfd)
    output = str(tmp_path / "x")
    assert str(tmp_path) in refused(["report", str(tmp_path), "-o", output], capfd)
    assert str(tmp_path) in refused(["recover", str(tmp_path), "-o", output], capfd)


def test_help_is_no_error(capfd: Lines) -> None:
    assert run(["simulate", "--help"]) == 0
    out, err = capfd.readouterr()
    assert "dftc simulate" in out
    assert err == ""


def test_no_privilege_is_asked_for_to_refuse() -> None:
    assert os.sched_getscheduler(0) == os.SCHED_OTHER  # nothing above raised this process
