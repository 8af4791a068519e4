"""A robot with hidden payload and real friction: calibrated, it knows a loss from what is none."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dftc_rt.analysis.metrics import evaluate
from dftc_rt.cli.main import run as command
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.config.calibration import load_calibration
from dftc_rt.control.signals import ACTUATOR_LOSS, PAYLOAD_CHANGE

RIG = (
    'rig.plant.friction="lugre"',
    "rig.plant.coulomb_fraction=0.02",
    "rig.plant.viscous_fraction=0.01",
    "rig.plant.payload_kg=1.0",
)
SCENARIO = "panda_shoulder_loss"
JOINT = 1


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibration") / "panda.toml"
    sets = [word for item in RIG for word in ("--set", item)]
    arguments = ["calibrate", SCENARIO, "-o", str(path), "--runs", "2", "--seconds", "20"]
    assert command([*arguments, *sets]) == 0
    return path


@pytest.fixture(scope="module")
def simulate(calibration: Path) -> Callable[..., tuple[Any, Any]]:
    def run(fault: str, *extra: str, calibrated: bool = True) -> tuple[Any, Any]:
        sets = [*RIG, f"fault={fault}", "duration_s=10", *extra]
        if calibrated:
            sets.append(f"control.calibration={calibration}")
        return run_simulation(open_session(SCENARIO, sets), progress=False)

    return run


def test_the_file_says_what_is_hidden(calibration: Path) -> None:
    found = load_calibration(calibration)
    nominal = open_session(SCENARIO).robot.model.inertias[7].mass
    assert found.link[0].mass_kg - nominal == pytest.approx(1.0, abs=0.3)
    assert found.link[0].mass_kg - nominal == pytest.approx(1.0, abs=4 * found.link[0].mass_std_kg)
    limits = np.array([87, 87, 87, 87, 12, 12, 12])
    coulomb = np.array([joint.coulomb for joint in found.joint])
    assert np.all(coulomb > 0.015 * limits)  # it grows with the load there
    assert np.all(coulomb < 0.04 * limits)
    assert max(found.held_out_percent) < 1.0


def test_without_it_nothing_works(simulate: Callable[..., Any]) -> None:
    run, outcome = simulate("[]", calibrated=False)
    alarms = evaluate(run)["joints"]
    assert outcome.end_state != "done" or sum(j["false_alarms"] for j in alarms.values()) > 0


def test_with_it_there_is_no_alarm(simulate: Callable[..., Any]) -> None:
    run, outcome = simulate("[]", "reference.seed=77")
    assert outcome.end_state == "done"
    assert not np.any(run.cycle["verdict"] == ACTUATOR_LOSS)
    error = 1e3 * np.sqrt(np.mean((run.cycle["q"] - run.cycle["qd"])[2000:] ** 2, axis=0))
    assert np.all(error < 6.0), error


def test_a_loss_is_noticed_at_once_and_attributed_soon(simulate: Callable[..., Any]) -> None:
    fault = '[{kind="loss",joint="panda_joint2",start_s=6,effectiveness=0.6}]'
    run, outcome = simulate(fault, "reference.seed=77")
    assert outcome.end_state == "done"
    t, verdict = run.cycle["t"], run.cycle["verdict"][:, JOINT]
    after = t >= 6.0
    anomaly = t[after & (verdict != 0) & (verdict != 4)][0]
    loss = t[after & (verdict == ACTUATOR_LOSS)][0]
    assert anomaly < 6.15
    assert loss < 7.5
    settled = t > loss + 0.5
    rho = run.cycle["rho_hat"][settled, JOINT]
    assert np.sqrt(np.mean((rho[:-600] - 0.6) ** 2)) < 0.05
    others = np.delete(run.cycle["verdict"], JOINT, axis=1)
    assert not np.any(others == ACTUATOR_LOSS)


@pytest.mark.parametrize(
    "fault",
    [
        '[{kind="payload",start_s=6,payload_kg=0.5}]',
        '[{kind="payload",start_s=6,payload_kg=1.0}]',
        '[{kind="contact",start_s=6,end_s=6.3,force_n=[0,0,-20]}]',
        '[{kind="friction",start_s=6,factor=1.5}]',
    ],
    ids=["payload", "heavier payload", "contact", "friction"],
)
def test_what_is_no_loss_is_not_called_one(fault: str, simulate: Callable[..., Any]) -> None:
    run, outcome = simulate(fault, "reference.seed=77")
    assert outcome.end_state == "done"
    assert not np.any(run.cycle["verdict"] == ACTUATOR_LOSS)
    if "payload" in fault:
        assert np.any(run.cycle["verdict"] == PAYLOAD_CHANGE)


def test_a_loss_on_top_of_a_payload_is_named_late_and_tracked(simulate: Callable[..., Any]) -> None:
    """The payload is not in the joint's model yet, so ρ̂ has its torque in it: 0.45 for 0.6."""
    fault = (
        '[{kind="payload",start_s=3,payload_kg=1.0},'
        '{kind="loss",joint="panda_joint2",start_s=8,effectiveness=0.6}]'
    )
    run, outcome = simulate(fault, "reference.seed=77", "duration_s=15")
    assert outcome.end_state == "done"
    t, verdict = run.cycle["t"], run.cycle["verdict"]
    assert not np.any(verdict[t < 8.0] == ACTUATOR_LOSS)
    assert not np.any(np.delete(verdict, JOINT, axis=1) == ACTUATOR_LOSS)
    loss = t[(verdict[:, JOINT] == ACTUATOR_LOSS)][0]
    assert loss < 12.5  # tests that found a load before have to be outweighed
    settled = (t > loss + 0.5) & (t < 14.4)
    assert settled.sum() > 1000
    assert 0.4 < np.mean(run.cycle["rho_hat"][settled, JOINT]) < 0.65
    error = 1e3 * (run.cycle["q"] - run.cycle["qd"])[(t > 8.5) & (t < 14.4), JOINT]
    assert np.sqrt(np.mean(error**2)) < 2.0


def test_a_total_loss_stops_the_arm_at_once(simulate: Callable[..., Any]) -> None:
    run, outcome = simulate('[{kind="total",joint="panda_joint2",start_s=6}]', "reference.seed=77")
    assert outcome.end_state == "safe stop"
    assert "panda_joint2: estimated effectiveness" in outcome.reason
    after = run.cycle["t"][run.cycle["verdict"][:, JOINT] == ACTUATOR_LOSS]
    assert after[0] < 6.1


def test_another_robots_calibration_is_refused(
    calibration: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setting = f"control.calibration={calibration}"
    assert command(["simulate", "ur5_elbow_loss", "--set", setting]) == 2
    error = capsys.readouterr().err
    assert "robot: found 'panda' (expected 'ur5')" in error
    assert error.count("\n") == 1


def test_a_log_recorded_with_a_calibration_gives_the_same_torque_constants(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, log = tmp_path / "a.toml", tmp_path / "b.toml", tmp_path / "healthy.mcap"
    rig = ["--set", "rig.plant.torque_constant=0.85"]
    brief = ["--runs", "1", "--seconds", "12"]
    assert command(["calibrate", "ur5_elbow_loss", "-o", str(first), *brief, *rig]) == 0
    used = ["--set", f"control.calibration={first}", "--set", "fault=[]"]
    motion = ["--set", "duration_s=12", "--set", "reference.seed=5"]
    assert command(["simulate", "ur5_elbow_loss", "--log", str(log), *used, *motion, *rig]) == 0
    assert command(["calibrate", "ur5_elbow_loss", "-o", str(second), "--log", str(log)]) == 0
    constants = [
        np.array([joint.torque_constant for joint in load_calibration(path).joint])
        for path in (first, second)
    ]
    loaded = [1, 2]
    np.testing.assert_allclose(constants[0][loaded], 0.85, atol=0.01)
    np.testing.assert_allclose(constants[1][loaded], constants[0][loaded], atol=0.01)
    first.unlink()
    capsys.readouterr()
    assert command(["calibrate", "ur5_elbow_loss", "-o", str(second), "--log", str(log)]) == 2
    error = capsys.readouterr().err
    assert "recorded with a calibration that cannot be read" in error
    assert error.count("\n") == 1
