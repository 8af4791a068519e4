"""Every law through shipped scenarios: faults, calibration, what is refused."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest

from dftc_rt.analysis.metrics import evaluate, running_mask, tracking_error
from dftc_rt.calibration import build
from dftc_rt.calibration.regression import FRICTION, Fit
from dftc_rt.cli.main import run as dftc
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.config.calibration import Calibration
from dftc_rt.control import laws
from dftc_rt.controller import prepare
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.regressor import inertial_parameters
from dftc_rt.errors import InputError

LAWS = tuple(name for name in laws.NAMES if name != "paper")
ESTIMATES = ("dftc", "momentum", "adaptive", "oracle")
FAULTED = {"panda_shoulder_loss": "panda_joint2", "ur5_elbow_loss": "elbow_joint"}


@cache
def _metrics(scenario: str, law: str) -> dict[str, Any]:
    start = ["duration_s=3.0", "fault[0].start_s=1.0", f"control.law={law}"]
    run, outcome = run_simulation(open_session(scenario, start), progress=False)
    assert outcome.end_state == "done", outcome.reason
    assert run.torque_limit is not None
    assert (np.abs(run.cycle["tau_cmd"]) <= np.array(run.torque_limit) * (1.0 + 1e-9)).all()
    return evaluate(run)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("scenario", FAULTED)
def test_each_law_rides_out_a_shipped_scenario(scenario: str, law: str) -> None:
    found = _metrics(scenario, law)
    joint = found["joints"][FAULTED[scenario]]
    assert found["law"] == law
    assert (joint["rho_rmse"] is None) == (law not in ESTIMATES)
    assert sum(each["false_alarms"] for each in found["joints"].values()) == 0
    none = _metrics(scenario, "computed_torque")["joints"][FAULTED[scenario]]
    if law in (*ESTIMATES, "eso"):
        assert joint["rmse_faulty_mrad"] < 0.2 * none["rmse_faulty_mrad"]
    if law in ESTIMATES:
        assert joint["rho_rmse"] < 0.05
        assert joint["detection_delay_s"] < 0.8
    best = _metrics(scenario, "oracle")["joints"][FAULTED[scenario]]
    assert best["peak_after_fault_mrad"] <= joint["peak_after_fault_mrad"]


def calibration(robot: Robot, viscous: float, coulomb: float) -> Calibration:
    """The nominal robot with a friction that is known."""
    n = robot.n
    values = dict.fromkeys(FRICTION, np.zeros(n)) | {
        "viscous": np.full(n, viscous),
        "coulomb": np.full(n, coulomb),
        "armature": robot.armature,
        "torque_constant": np.ones(n),
    }
    load = inertial_parameters(robot)
    std = dict.fromkeys(FRICTION, np.zeros(n))
    nothing: tuple[tuple[str, ...], ...] = ((),) * n
    fit = Fit(load, np.zeros_like(load), values, std, np.zeros(n), nothing, 1)
    return build.calibration_of(robot, fit, "test", 1.0)


@pytest.mark.parametrize("law", ["computed_torque", "momentum", "eso", "adaptive", "oracle"])
def test_calibrated_friction_is_compensated(law: str) -> None:
    opened = open_session(
        "ur5_elbow_loss",
        [f"control.law={law}", "duration_s=3.0", "fault=[]", "rig.plant.viscous=1.0",
         "rig.plant.coulomb=0.5", "supervisor.rho_min=0.01"],
    )  # fmt: skip
    known = prepare(opened.scenario, opened.robot, calibration(opened.robot, 1.0, 0.5))
    error = []
    for session in (opened, dataclasses.replace(opened, parts=known)):
        run, outcome = run_simulation(session, progress=False)
        assert outcome.end_state == "done", outcome.reason
        error.append(tracking_error(run)[running_mask(run)][1200:])
    worse, better = (float(np.sqrt((each**2).mean())) for each in error)
    assert better < 0.5 * worse


@pytest.mark.parametrize("law", ["momentum", "adaptive"])
def test_closed_forms_are_refused_where_c_is_not_known(law: str) -> None:
    with pytest.raises(InputError, match="closed form"):
        open_session("paper_example2", [f"control.law={law}"])


@pytest.mark.parametrize("law", ["computed_torque", "eso", "oracle", "pd_gravity"])
def test_other_laws_run_on_closed_forms(law: str) -> None:
    run, outcome = run_simulation(
        open_session("paper_example2_urdf", [f"control.law={law}", "duration_s=1.0"]),
        progress=False,
    )
    plant, ended = run_simulation(
        open_session("paper_example2", [f"control.law={law}", "duration_s=1.0"]), progress=False
    )
    assert ended.end_state == outcome.end_state == "done", ended.reason
    assert np.abs(plant.cycle["q"] - run.cycle["q"]).max() < 5e-3


def test_nobody_moves_a_real_robot_with_the_oracle(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["control", "ur5_elbow_loss", "--bus", "socketcan:can0,can1", "--set"]
    assert dftc([*command, "control.law=oracle"]) == 2
    assert "oracle" in capsys.readouterr().err
