"""``dftc paper``: bad input before anything is computed, other variants, interruption."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import psutil
import pytest

from dftc_rt.cli import paper as command
from dftc_rt.cli.main import run
from dftc_rt.paper import runs
from dftc_rt.paper.runs import Drawn, Results
from dftc_rt.paper.verdicts import Sampled
from tests.integration.commands import DFTC, until
from tests.paper import synthetic


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[Drawn]:
    """Replace the computation by made-up results; what was asked for is kept."""
    asked: list[Drawn] = []

    def compute(drawn: Drawn, extra: Any, progress: Any) -> Results:
        asked.append(drawn)
        measures: dict[str, Any] = {}
        for example in drawn.examples:
            measures |= synthetic.measures(example, drawn)
        sampled = Sampled(0.01, (1.0, 2.0), (3.0, 4.0), "done")
        return Results(measures, synthetic.curves(drawn), {task.name: sampled for task in extra})

    monkeypatch.setattr(runs, "compute", compute)
    return asked


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--example", "3"], "one of 1, 2"),
        (["--example", "x"], "--example"),
        (["--epsilon", "-0.01"], "--epsilon"),
        (["--epsilon", "0"], "--epsilon"),
        (["--epsilon", "nan"], "--epsilon"),
        (["--gain", "nonsense"], "one of none, true, true_rho, measured, desired"),
        (["--robust", "nonsense"], "held"),
        (["--identifier", "nonsense"], "frozen"),
        (["-o", "a_file"], "a_file: is a file"),
        (["-o", "a_file/below"], "a_file/below"),
        (["-o", ""], "''"),
        (["-o", "taken"], "figure07.svg"),
        (["-o", "/proc/nowhere"], "/proc/nowhere"),
    ],
    ids=" ".join,
)
def test_bad_input_is_one_line_before_anything_is_computed(
    arguments: list[str],
    words: str,
    computed: list[Drawn],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a_file").touch()
    Path("taken/figure07.svg").mkdir(parents=True)
    there = sorted(tmp_path.rglob("*"))
    given = arguments if "-o" in arguments else [*arguments, "-o", "new/folder"]
    assert run(["paper", *given]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith("dftc: ")
    assert err.count("\n") == 1
    assert words in err
    assert computed == []
    assert sorted(tmp_path.rglob("*")) == there


def test_no_matplotlib_is_a_lack_of_the_machine(
    computed: list[Drawn], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    assert run(["paper", "-o", str(tmp_path / "new")]) == 3
    assert "pip install 'dftc_rt[figures]'" in capfd.readouterr().err
    assert not (tmp_path / "new").exists()


def test_one_example_and_another_variant(
    computed: list[Drawn], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    flags = ["--example", "2", "--gain", "true_rho", "--robust", "held", "--identifier", "adapt"]
    assert run(["paper", "-o", str(tmp_path / "new"), *flags, "--epsilon", "0.02", "--json"]) == 0
    assert computed == [Drawn((2,), 0.02, "true_rho", "held", "adapt")]
    out, _ = capfd.readouterr()
    assert out.count("\n") == 1
    found = json.loads(out)
    assert [figure["figure"] for figure in found["figures"]] == [6, 7, 8, 9, 10]
    assert found["drawn"]["default"] is False
    for words in ("ε = 0.02", "are held", "goes on adapting", "fed with the true ρ"):
        assert words in found["drawn"]["shown"]
    page = (tmp_path / "new" / "summary.md").read_text("utf-8")
    assert "This is not the default." in page
    assert not (tmp_path / "new" / "figure01.png").exists()


def test_what_people_read(
    computed: list[Drawn], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["paper", "-o", str(tmp_path / "new")]) == 0
    out, _ = capfd.readouterr()
    claim = "both joints track their references"
    assert out.splitlines()[1].split() == ["1", *claim.split(), "2", "mrad", "reproduces"]
    assert "our ρ̂, 1 kHz with noise, split: RMSE 0.01, to reach 0.02: reached" in out
    assert f"{tmp_path / 'new' / 'summary.md'} says what each number is; 32 files" in out
    assert "This is not the default." not in (tmp_path / "new" / "summary.md").read_text("utf-8")
    again = ["paper", "-o", str(tmp_path / "new"), "--example", "2"]
    assert run(again) == 0  # and once more into the same folder


def test_a_folder_made_for_nothing_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "compute", interrupted)
    assert run(["paper", "-o", str(tmp_path / "new" / "folder")]) == 130
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().err == "dftc: interrupted\n"


def alive(process: psutil.Process) -> bool:
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_no_worker_outlives_the_command(number: int, tmp_path: Path) -> None:
    folder = tmp_path / "new"
    started = subprocess.Popen(
        [DFTC, "paper", "-o", str(folder)], stderr=subprocess.PIPE, stdout=subprocess.PIPE
    )
    watched = psutil.Process(started.pid)
    wanted = min(runs.WORKERS, len(os.sched_getaffinity(0)))
    until(lambda: len(watched.children()) == wanted, "the workers")
    workers = watched.children()
    started.send_signal(number)
    out, err = started.communicate(timeout=60)
    until(lambda: not any(alive(worker) for worker in workers), "the end of the workers")
    assert out == b""
    if number == signal.SIGINT:
        assert started.returncode == 130
        assert err == b"dftc: interrupted\n"
        assert list(tmp_path.iterdir()) == []


def test_the_shipped_scenarios_are_the_examples() -> None:
    for number, name in command.SCENARIOS.items():
        opened = command.session.open_session(name)
        example = runs.EXAMPLES[number]
        assert opened.scenario.duration_s == example.duration_s
        assert opened.scenario.reference.kind == example.reference
        assert opened.scenario.fault[0].start_s == example.fault_s
        assert opened.scenario.rig.plant.q0_rad == (1.0, 1.0)
        assert opened.scenario.executor.rate_hz == 1000
        assert opened.scenario.rig.drive.velocity_noise_rad_s > 0.0
