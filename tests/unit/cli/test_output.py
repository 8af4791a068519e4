"""Files to be written are refused before anything starts, and none that is there is lost."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from dftc_rt.cli.main import run
from dftc_rt.cli.output import check_output, log_file
from dftc_rt.cli.session import Session, open_session
from dftc_rt.errors import EnvironmentLacksError, InputError

PANDA = "panda_shoulder_loss"


@pytest.fixture(scope="module")
def opened() -> Session:
    return open_session(PANDA)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("target", ["/proc/x.mcap", "/dev/null", "/dev/full", "pipe", ".", ""])
@pytest.mark.parametrize(
    "command",
    [
        ["simulate", PANDA, "--log"],
        ["hil", PANDA, "--log"],
        ["report", "run.mcap", "-o"],
    ],
    ids=lambda command: command[0],
)
def test_what_is_no_file_is_refused_at_once(
    command: list[str],
    target: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    os.mkfifo("pipe")
    Path("run.mcap").write_bytes(b"not looked at")

    def started(*_: object) -> None:
        raise AssertionError("the run was prepared before its log was checked")

    monkeypatch.setattr("dftc_rt.cli.hil.warm_up", started)
    monkeypatch.setattr("dftc_rt.cli.simulate.warm_up", started)
    assert run([*command, target]) == 2
    err = capfd.readouterr().err
    assert err.startswith("dftc: ")
    assert err.count("\n") == 1
    assert (target or "''") in err
    assert sorted(folder.iterdir()) == [folder / "pipe", folder / "run.mcap"]


def test_checking_changes_nothing(folder: Path) -> None:
    Path("old").write_text("as it was")
    check_output("old")
    check_output("new")
    Path("link").symlink_to("elsewhere")
    check_output("link")
    assert Path("old").read_text() == "as it was"
    assert sorted(p.name for p in folder.iterdir()) == ["link", "old"]


def test_a_name_too_long_and_a_full_disk_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="File name too long") as caught:
        check_output("n" * 300)
    assert len(str(caught.value)) < 200

    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(EnvironmentLacksError, match="no space left to write x"):
        check_output("x")
    assert not Path("x").exists()


def test_something_else_is_not_replaced_by_a_log(opened: Session) -> None:
    Path("scenario.toml").write_text('name = "mine"')
    with pytest.raises(InputError, match="holds something else"), log_file(opened, "scenario.toml"):
        pass
    Path("empty.mcap").touch()
    Path("log.mcap").write_bytes(b"\x89MCAP0\r\n and more")
    for name in ("empty.mcap", "log.mcap", "new.mcap"):
        with log_file(opened, name) as path:
            assert path == Path(name)
    assert Path("scenario.toml").read_text() == 'name = "mine"'


def test_the_place_of_the_report_is_checked_too(opened: Session) -> None:
    Path("run.html").mkdir()
    refusal = pytest.raises(InputError, match=r"run\.html: is a folder")
    with refusal, log_file(opened, "run.mcap", report=True):
        pass
    with log_file(opened, "run.mcap"):
        pass


def test_a_default_name_is_given_once(opened: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "strftime", lambda form: "20260101-000000")
    stem = "panda-shoulder-loss-20260101-000000"
    used = []
    for _ in range(3):
        with log_file(opened, None, report=True) as path:
            path.write_text("a log")
            used.append(path.name)
    Path("logs", f"{stem}-4.html").write_text("the report of a log that is elsewhere")
    with log_file(opened, None) as path:
        path.write_text("a log")
        used.append(path.name)
    assert used == [f"{stem}.mcap", f"{stem}-2.mcap", f"{stem}-3.mcap", f"{stem}-5.mcap"]


def test_a_name_taken_by_a_run_that_is_on_is_taken(
    opened: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "strftime", lambda form: "20260101-000000")
    with log_file(opened, None) as first, log_file(opened, None) as second:
        assert first != second


def test_what_was_not_used_is_removed(opened: Session, folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt), log_file(opened, None):
        raise KeyboardInterrupt
    with log_file(opened, "a/b/run.mcap"):
        assert Path("a/b").is_dir()
    assert list(folder.iterdir()) == []
    with log_file(opened, "a/b/run.mcap") as path:
        path.touch()
    assert Path("a/b/run.mcap").exists()


def test_a_run_with_an_endless_name_has_a_log(folder: Path) -> None:
    opened = open_session(PANDA, [f"name={'n' * 400}"])
    with log_file(opened, None, report=True) as path:
        assert len(path.with_suffix(".2.mcap").name) < 255
        assert path.name.startswith("n" * 100)
