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


HARD = (
    "--set", "control.law=computed_torque", "--set", "supervisor.tracking_error_rad=3.0",
    "--set", "rig.plant.friction=lugre", "--set", "rig.plant.coulomb_fraction=0.02",
    "--set", "rig.plant.viscous_fraction=0.01", "--set", "rig.plant.torque_constant=0.97",
    "--set", 'fault=[{kind="payload", start_s=0.3, end_s=0.8, payload_kg=1.0},'
    ' {kind="contact", start_s=0.4, end_s=0.6, force_n=[0.0, 3.0, -5.0]},'
    ' {kind="friction", start_s=0.5, factor=1.5},'
    ' {kind="lag", joint="panda_joint4", start_s=0.2, lag_s=0.004},'
    ' {kind="stuck_torque", joint="panda_joint6", start_s=0.5, end_s=0.52}]',
)  # fmt: skip


def test_a_rig_that_is_not_the_model_is_as_repeatable(simulated: Path, tmp_path: Path) -> None:
    logs = [tmp_path / name for name in ("one.mcap", "again.mcap", "hil.mcap")]
    for log in logs[:2]:
        settings = ("--set", "duration_s=1.0", *HARD)
        assert run(["simulate", "panda_shoulder_loss", "--log", str(log), "--json", *settings]) == 0
    options = ("--lockstep", "--bus", "inprocess", "--log", logs[2], "--json", "--no-report")
    done = dftc("hil", "panda_shoulder_loss", *options, "--set", "duration_s=1.0", *HARD)
    assert done.returncode == 0, done.stderr
    one, again, there = map(repeatable, logs)
    assert len(one[0]) > 1000 * 8
    assert again == one
    assert there == one
    assert one[1] != repeatable(simulated)[1]


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
