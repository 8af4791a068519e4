"""``dftc benchmark faults`` on a tiny grid: rows, page, going on, and the sealed draw."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from dftc_rt.benchmark.store import load_faults, load_negative
from dftc_rt.cli.main import run as command

TINY = ("--quick", "--law", "dftc", "--kind", "loss40", "--joint", "elbow_joint", "--jobs", "1")
FAULTS = (*TINY, "--part", "faults")

Run = Callable[..., int]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("benchmark") / "new" / "folder"
    assert command(["benchmark", "faults", "-o", str(found), *TINY]) == 0
    return found


def cells(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_row_for_every_case_and_every_joint_of_the_twin(folder: Path) -> None:
    rows = load_faults(folder / "results.csv")
    twins = [row for row in rows if row.kind == "twin"]
    assert len(twins) == 6
    assert {row.end_state for row in rows} == {"done"}
    loaded = {row.joint for row in twins if row.loaded}
    assert {"shoulder_lift_joint", "elbow_joint"} <= loaded < {row.joint for row in twins}
    (case,) = [row for row in rows if row.kind != "twin"]
    assert (case.kind, case.joint) == ("loss40", "elbow_joint")
    assert case.anomaly_delay_s is not None
    assert case.anomaly_information_s is not None
    assert case.anomaly_information_s < case.anomaly_delay_s < 0.2
    assert case.rho_rmse is not None
    assert case.rho_rmse < 0.1
    assert case.effort == pytest.approx(1 / 0.6, rel=0.05)
    assert not case.beyond


def test_the_negative_set_is_run_too(folder: Path) -> None:
    rows = load_negative(folder / "negative.csv")
    assert [row.item for row in rows] == ["multisine", "multisine small"]
    assert all(row.simulated_s >= 30.0 for row in rows)


def test_the_page_is_there(folder: Path) -> None:
    text = (folder / "benchmark.md").read_text(encoding="utf-8")
    assert "1 cases with 1 twins, 2 runs without" in text
    assert (folder / "images" / "benchmark_delays.png").exists()


def test_run_again_it_has_nothing_to_do(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (folder / "results.csv").read_bytes()
    assert command(["benchmark", "faults", "-o", str(folder), *FAULTS, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["cases"] == 1
    assert (folder / "results.csv").read_bytes() == before


def test_a_torn_row_is_run_again_and_is_the_same(folder: Path) -> None:
    path = folder / "results.csv"
    before = cells(path)
    path.write_text(path.read_text()[:-30])
    assert command(["benchmark", "faults", "-o", str(folder), *FAULTS]) == 0
    after = cells(path)
    for row in (*before, *after):
        row.pop("cpu_s")
    assert after == before


def test_the_sealed_draw_needs_what_is_frozen(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sealed = ["benchmark", "faults", "-o", str(folder), *FAULTS, "--draw", "sealed"]
    assert command(sealed) == 2
    assert "nothing is frozen yet" in capsys.readouterr().err
    freeze = ["benchmark", "faults", "-o", str(folder), *FAULTS, "--freeze"]
    assert command(freeze) == 0
    assert len(cells(folder / "sweep.csv")) == 2
    assert command(sealed) == 0
    rows = load_faults(folder / "results.csv")
    assert {row.draw for row in rows} == {"tuning", "sealed"}
    assert not {row.seed for row in rows if row.draw == "sealed"} & {
        row.seed for row in rows if row.draw == "tuning"
    }
    text = (folder / "benchmark.md").read_text(encoding="utf-8")
    assert "Draw *sealed*" in text
    assert "before any sealed run" in text
    capsys.readouterr()
    assert command(freeze) == 2
    assert "the sealed draw has been run" in capsys.readouterr().err
    calibration = folder / "calibration" / "ur5.toml"
    calibration.write_text(calibration.read_text() + "\n# changed\n")
    assert command(sealed) == 2
    assert "frozen.toml: ur5: frozen with" in capsys.readouterr().err
