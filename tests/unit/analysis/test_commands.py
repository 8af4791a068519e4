"""The functions under ``dftc analyze``, ``report`` and ``recover``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.cli.analyze import analyze
from dftc_rt.cli.main import run as main
from dftc_rt.cli.recover import recover
from dftc_rt.cli.report import report
from dftc_rt.control.signals import NAMES
from dftc_rt.errors import LogError
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.schema import cycle_layout


@pytest.fixture
def log(tmp_path: Path) -> Path:
    layout = cycle_layout(["a"], NAMES)
    records = np.zeros((3000, layout.size))
    records[:, 0] = np.arange(3000) / 1000
    records[:, 4] = 3.0
    records[:, layout.fields.index("qd_a")] = 0.002
    with Recorder(tmp_path / "run.mcap", layout, scenario='[control]\nlaw = "dftc"\n') as out:
        out.write_cycles(records)
    return tmp_path / "run.mcap"


def test_json_is_one_object_and_nothing_else(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert analyze(log, twin=log, json=True) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found["law"] == "dftc"
    assert found["joints"]["a"]["rmse_healthy_mrad"] == pytest.approx(2.0)
    assert err == ""


def test_table_is_on_stdout(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert analyze(log) == 0
    out, err = capsys.readouterr()
    assert "3000 cycles" in out
    assert err == ""


def test_report_names_what_it_wrote(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = log.with_suffix(".html")
    assert report(log, output=target) == 0
    assert capsys.readouterr().out == f"{target}\n"
    assert target.read_text().startswith("<!doctype html>")


def test_logs_are_compared(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = log.with_name("other.mcap")
    other.write_bytes(log.read_bytes())
    assert main(["report", str(log), str(other), "-o", str(log.with_name("both.html"))]) == 0
    assert "against run" in log.with_name("both.html").read_text()
    layout = cycle_layout(["z"], NAMES)
    with Recorder(other, layout) as out:
        out.write_cycles(np.zeros((10, layout.size)))
    assert main(["report", str(log), str(other), "-o", str(log.with_name("x.html"))]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"dftc: {other}: another robot, with the joints z")
    assert told.count("\n") == 1
    assert not log.with_name("x.html").exists()


def test_a_figure_is_chosen_by_format_or_ending(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, start in (("1.pdf", b"%PDF"), ("1.png", b"\x89PNG"), ("1.svg", b"<?xml")):
        target = log.with_name(name)
        assert main(["report", str(log), "-o", str(target), "--format", target.suffix[1:]]) == 0
        assert target.read_bytes().startswith(start)
    again = log.with_name("2.svg")
    assert main(["report", str(log), "-o", str(again)]) == 0
    assert again.read_bytes() == log.with_name("1.svg").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["-o", "r.gif"], "r.gif: an ending '.gif' of no format"),
        (["-o", "r.png", "--format", "pdf"], "r.png: an ending '.png' (expected '.pdf' of pdf)"),
        (["-o", "r.png", "--format", "eps"], "--format: 'eps'"),
        (["-o", "r.html", "--joint", "a"], "--joint: a report in HTML shows all of the run"),
        (["-o", "r.html", "--span", "1", "2"], "--span: a report in HTML"),
        (["-o", "r.png", "--span", "7", "9"], "--span: 7 to 9 s"),
    ],
)
def test_what_cannot_be_written_is_one_line(
    log: Path, arguments: list[str], told: str, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(log.parent)
    assert main(["report", str(log), *arguments]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"dftc: {told}")
    assert err.count("\n") == 1


def test_recover_then_analyze(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torn, whole = log.with_name("torn.mcap"), log.with_name("whole.mcap")
    torn.write_bytes(log.read_bytes()[:-1])
    with pytest.raises(LogError, match="dftc recover"):
        analyze(torn)
    assert recover(torn, output=whole) == 0
    assert "(up to the tear)" in capsys.readouterr().out
    analyze(whole, json=True)
    assert json.loads(capsys.readouterr().out)["cycles"] == 3000
