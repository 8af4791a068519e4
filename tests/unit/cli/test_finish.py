"""What ``dftc hil`` and ``dftc control`` say at the end, whatever happened to the recorder."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from dftc_rt.cli.hil import finish
from dftc_rt.cli.processes.child import Flags
from dftc_rt.cli.processes.launcher import Ended, Launcher
from dftc_rt.cli.processes.roles import Rings
from dftc_rt.cli.session import Session, open_session
from dftc_rt.cli.simulate import run_simulation


@pytest.fixture(scope="module")
def opened() -> Session:
    return open_session("ur5_elbow_loss", ["duration_s=0.5", "fault=[]"])


@pytest.fixture
def ended(opened: Session, tmp_path: Path) -> Ended:
    """A run whose recorder was killed: the first file is torn, the second is whole."""
    whole = tmp_path / "run.2.mcap"
    with opened.recorder(whole, epoch_ns=0) as recorder:
        _, outcome = run_simulation(opened, recorder, progress=False)
    torn = tmp_path / "run.mcap"
    torn.write_bytes(whole.read_bytes()[:-100])
    controller = {"outcome": dataclasses.asdict(outcome)}
    trouble = ["dftc-recorder was killed (SIGKILL); another one goes on"]
    return Ended(controller=controller, logs=[torn, whole], trouble=trouble)


def test_all_files_are_named_and_summarised(
    opened: Session, ended: Ended, capsys: pytest.CaptureFixture[str]
) -> None:
    assert finish(opened, ended, report=True, json=False) == 0
    out, err = capsys.readouterr()
    first, second = ended.logs
    assert f"log:    {first}\n        {second}\nreport: {first.with_suffix('.html')}\n" in out
    assert "went to its end" in out
    assert f"the summary is made of 2 of 2 files, {first} up to its tear\n" in err
    assert finish(opened, ended, report=False, json=True) == 0
    assert json.loads(capsys.readouterr().out)["logs"] == [str(first), str(second)]


def test_a_report_that_cannot_be_written_leaves_the_summary(
    opened: Session, ended: Ended, capsys: pytest.CaptureFixture[str]
) -> None:
    ended.logs[0].with_suffix(".html").mkdir()
    assert finish(opened, ended, report=True, json=False) == 1
    out, err = capsys.readouterr()
    assert "went to its end" in out
    assert "report:" not in out
    assert "no report: " in err


def test_another_recorder_never_takes_a_file_that_is_there(opened: Session, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    log.touch()
    for number in (2, 3):
        (tmp_path / f"run.{number}.mcap").write_text("of an earlier run")
    launcher = Launcher(
        Rings.create(opened),
        Flags(),
        lambda: {},
        None,
        lambda path: {"path": str(path)},
        log,
        lambda rings: None,
    )
    for _ in range(3):
        launcher._start_recorder(lambda path: {}).kill()
    assert [path.name for path in launcher._ended.logs] == ["run.mcap", "run.4.mcap", "run.5.mcap"]
