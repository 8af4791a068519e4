"""One scenario, three ways of running it in lock-step: the same bytes in the log."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dftc_rt.cli.main import run
from tests.integration.commands import dftc, repeatable

SHORT = ("--set", "duration_s=1.0", "--set", "fault[0].start_s=0.4")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate(tmp_path_factory.mktemp("simulated") / "run.mcap")


def simulate(log: Path, *more: str) -> Path:
    assert run(["simulate", "panda_shoulder_loss", "--log", str(log), "--json", *SHORT, *more]) == 0
    return log


@pytest.mark.parametrize("bus", ["unix", "inprocess"])
def test_hil_in_lockstep_gives_the_bytes_of_simulate(
    bus: str, simulated: Path, tmp_path: Path
) -> None:
    log = tmp_path / "run.mcap"
    options = ("--lockstep", "--bus", bus, "--log", log, "--json", "--no-report")
    done = dftc("hil", "panda_shoulder_loss", *options, *SHORT)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["cycles"] > 1000
    one, other = repeatable(simulated), repeatable(log)
    assert len(one[0]) > 1000 * 8
    assert len(one[1]) > 1000 * 8
    assert other == one


@pytest.mark.parametrize("scenario", ["paper_example1", "paper_example2_urdf"])
def test_the_papers_plants_over_unix_sockets_give_the_bytes_of_simulate(
    scenario: str, tmp_path: Path
) -> None:
    here, there = tmp_path / "here.mcap", tmp_path / "there.mcap"
    assert run(["simulate", scenario, "--log", str(here), "--json", *SHORT]) == 0
    options = ("--lockstep", "--bus", "unix", "--log", there, "--json", "--no-report")
    done = dftc("hil", scenario, *options, *SHORT)
    assert done.returncode == 0, done.stderr
    one, other = repeatable(here), repeatable(there)
    assert len(one[0]) > 1000 * 8
    assert len(one[1]) > 1000 * 8
    assert other == one


def test_same_seed_same_bytes_and_another_seed_others(simulated: Path, tmp_path: Path) -> None:
    first = repeatable(simulated)
    assert repeatable(simulate(tmp_path / "again.mcap")) == first
    other = repeatable(simulate(tmp_path / "other.mcap", "--set", "seed=2"))
    assert other[0] != first[0]
    assert other[1] != first[1]
