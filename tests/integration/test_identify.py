"""Networks trained on a robot with friction that its model does not have, and used afterwards."""

import json
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.cli.main import run as command
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.config.identification import load_identification

SCENARIO = "ur5_elbow_loss"
RIG = ("rig.plant.viscous_fraction=0.05",)  # friction of the joint's own velocity: to be learned
BRIEF = ("--runs", "3", "--seconds", "12", "--grid-q", "3", "--grid-v", "9")


def _sets(*settings: str) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("identification") / "ur5.npz"
    assert command(["identify", SCENARIO, "-o", str(path), *BRIEF, *_sets(*RIG)]) == 0
    return path


def _residual(*settings: str) -> np.ndarray:
    sets = [*RIG, "fault=[]", "duration_s=8", "reference.seed=77", "control.ftc=false", *settings]
    run, _ = run_simulation(open_session(SCENARIO, [*sets, "supervisor.rho_min=0.01"]))
    return np.sqrt(np.mean(run.cycle["residual"][2000:] ** 2, axis=0))


def test_friction_of_the_own_velocity_transfers(trained: Path) -> None:
    without, with_ = _residual(), _residual(f"control.identification={trained}")
    assert np.all(with_ < 0.5 * without), (without, with_)


def test_in_the_law_it_helps_the_tracking(trained: Path) -> None:
    def error(*settings: str) -> float:
        sets = [*RIG, "fault=[]", "duration_s=8", "control.ftc=false", *settings]
        opened = open_session(SCENARIO, [*sets, "supervisor.rho_min=0.01"])
        run, outcome = run_simulation(opened, progress=False)
        assert outcome.end_state == "done"
        return float(np.sqrt(np.mean((run.cycle["q"] - run.cycle["qd"])[2000:] ** 2)))

    used = f"control.identification={trained}"
    observer, law = error(used), error(used, "control.identification_in_law=true")
    assert law < 0.7 * observer


def test_cells_never_visited_keep_weight_zero(trained: Path) -> None:
    found = load_identification(trained)
    assert found.grid == (3, 9)
    assert 0 < found.visited.sum() < found.visited.size
    assert np.all(found.w_fo[~found.visited] == 0.0)
    assert np.all(found.w_go[~found.visited] == 0.0)
    assert found.seconds == pytest.approx(36.0, rel=0.05)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("logs")
    out = [folder / f"{k}.mcap" for k in range(3)]
    for k, path in enumerate(out):
        sets = (*RIG, "fault=[]", "duration_s=12", f"reference.seed={40 + k}")
        law = "control.law=computed_torque"
        assert command(["simulate", SCENARIO, "--log", str(path), *_sets(*sets, law)]) == 0
    return out


@pytest.mark.parametrize("count", [3, 2, 1])
def test_logs_serve_as_well(
    count: int, logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ur5.npz"
    given = [word for log in logs[:count] for word in ("--log", str(log))]
    capsys.readouterr()
    arguments = ["identify", SCENARIO, "-o", str(path), *given, "--grid-q", "1", "--grid-v", "9"]
    code = command([*arguments, "--json"])
    out, error = capsys.readouterr()
    if count < 3:  # a third of a log of 12 s is too short
        assert code == 2
        assert "a third of it is 4.0 s" in error
        assert not path.exists()
        return
    assert code == 0
    report = json.loads(out)
    assert report["training_s"] == pytest.approx(24.0, abs=0.1)
    assert report["held_out_s"] == pytest.approx(12.0, abs=0.1)
    for joint in report["joint"]:
        assert joint["held_out_percent"][1] < joint["held_out_percent"][0]
    assert load_identification(path).source == ", ".join(str(log) for log in logs)


def test_what_does_not_transfer_is_not_put_into_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ur5.npz"
    capsys.readouterr()
    # An exact model, and no friction: there is nothing to learn.
    brief = ("--runs", "2", "--seconds", "8", "--grid-q", "3", "--grid-v", "9")
    assert command(["identify", SCENARIO, "-o", str(path), *brief, "--json"]) == 0
    out, error = capsys.readouterr()
    report = json.loads(out)
    nothing = [joint["ridge"] is None for joint in report["joint"]]
    assert sum(nothing) >= 4, report
    for joint in report["joint"]:
        if joint["ridge"] is None:
            assert joint["held_out_percent"][0] == joint["held_out_percent"][1]
    if all(nothing):
        assert "no joint learned anything that transfers" in error


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--runs", "1"], "--runs: found 1 (expected 2 to 100)"),
        (["--seconds", "1"], "--seconds: found 1 (expected 5 to 3600)"),
        (["--grid-v", "100"], "--grid-v: found 100 (expected 1 to 99)"),
        (["--grid-q", "0"], "--grid-q: found 0 (expected 1 to 99)"),
        (_sets("control.gains.grid_q=5"), "control.gains.grid_q: is set by"),
        (_sets("control.law=paper"), "networks of its own"),
    ],
)
def test_bad_usage_is_one_line(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ur5.npz"
    assert command(["identify", SCENARIO, "-o", str(path), *arguments]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    assert not path.exists()


def test_another_file_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "precious.txt"
    path.write_text("precious\n")
    assert command(["identify", SCENARIO, "-o", str(path), *BRIEF]) == 2
    assert "is no NPZ archive" in capsys.readouterr().err
    assert path.read_text() == "precious\n"


def test_a_stale_file_in_the_scenario_does_not_stop_the_command_that_replaces_it(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stale = _sets("control.identification=gone.npz", "control.law=paper")
    assert command(["identify", SCENARIO, "-o", str(tmp_path / "x.npz"), *BRIEF, *stale]) == 2
    assert "gone.npz" not in capsys.readouterr().err
