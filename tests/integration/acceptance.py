"""The acceptance runs of one robot, in a form that another process can do and send back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dftc_rt.analysis import metrics
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.log.run import Run
from tests.integration.commands import rms

SCENARIOS = {"panda": "panda_shoulder_loss", "ur5": "ur5_elbow_loss"}
CASES = (
    ("panda", "panda_joint2"),
    ("panda", "panda_joint4"),
    ("ur5", "shoulder_lift_joint"),
    ("ur5", "elbow_joint"),
)
SHORT_S = 10.0  # of the runs that are only compared with


@dataclass(frozen=True)
class Verdict:
    """One faulted joint.

    Attributes:
        metrics: As ``dftc analyze --twin`` gives them, per joint, FTC on.
        end_states: Of twin, FTC on, FTC off, computed torque.
        early: RMSE of the faulted joint from 0.5 s after the fault to ``SHORT_S``, mrad: of
            FTC on, FTC off, computed torque.
    """

    metrics: dict[str, dict[str, Any]]
    end_states: tuple[str, str, str, str]
    early: tuple[float, float, float]


def loss(joint: str) -> str:
    return f'fault=[{{joint="{joint}", kind="loss", start_s=6.0, effectiveness=0.6}}]'


def judge(robot: str) -> dict[str, Verdict]:
    """Run the robot's cases."""
    scenario = SCENARIOS[robot]
    twin, twin_end = simulated(scenario, "fault=[]")
    found = {}
    for name, joint in CASES:
        if name != robot:
            continue
        with_ftc, end = simulated(scenario, loss(joint))
        short = f"duration_s={SHORT_S}"
        without, end_without = simulated(scenario, loss(joint), "control.ftc=false", short)
        plain, end_plain = simulated(scenario, loss(joint), "control.law=computed_torque", short)
        found[joint] = Verdict(
            metrics.evaluate(with_ftc, twin=twin)["joints"],
            (twin_end, end, end_without, end_plain),
            tuple(early(run, joint) for run in (with_ftc, without, plain)),  # type: ignore[arg-type]
        )
    return found


def simulated(scenario: str, *settings: str) -> tuple[Run, str]:
    """Return a run and how it ended."""
    run, outcome = run_simulation(open_session(scenario, settings), progress=False)
    return run, outcome.end_state


def early(run: Run, joint: str) -> float:
    t = run.cycle["t"]
    window = metrics.running_mask(run) & (t >= 6.5) & (t < SHORT_S)
    error = metrics.tracking_error(run)[window, run.joints.index(joint)]
    assert np.count_nonzero(window) > 3000
    return 1e3 * rms(error)
