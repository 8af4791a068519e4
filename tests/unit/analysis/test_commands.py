"""The functions under ``dftc analyze``, ``report`` and ``recover``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.cli.analyze import analyze
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


def test_recover_then_analyze(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torn, whole = log.with_name("torn.mcap"), log.with_name("whole.mcap")
    torn.write_bytes(log.read_bytes()[:-1])
    with pytest.raises(LogError, match="dftc recover"):
        analyze(torn)
    assert recover(torn, output=whole) == 0
    assert "(up to the tear)" in capsys.readouterr().out
    analyze(whole, json=True)
    assert json.loads(capsys.readouterr().out)["cycles"] == 3000
