"""Scenarios that ship, every actuator fault, and settings that must not change the result."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.analysis import metrics
from dftc_rt.cli.main import run as dftc
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.log.reader import read
from hil import SCENARIOS
from tests.integration.commands import rms

# The paper's start a radian off the reference: tests/integration/test_paper_scenarios.py.
ON_REFERENCE = sorted(
    p.stem for p in SCENARIOS.glob("*.toml") if not p.stem.startswith("paper_example")
)
ELBOW = 'joint = "elbow_joint", start_s = 1.0'


@pytest.mark.parametrize("name", ON_REFERENCE)
def test_every_shipped_scenario_runs(name: str) -> None:
    opened = open_session(name, ["duration_s=1.0"])
    run, outcome = run_simulation(opened, progress=False)
    assert outcome.end_state == "done"
    error = metrics.tracking_error(run)[metrics.running_mask(run)]
    assert error.shape == (1000, opened.robot.n)
    assert np.abs(error).max() < 0.02
    if name == "g1_upper_body":
        assert opened.robot.n == 17
    if name == "g1_knee_loss":
        assert opened.robot.n == 29


PROFILES = {
    "loss": ("effectiveness = 0.6", lambda t: np.full_like(t, 0.6)),
    "ramp": ("to = 0.7, over_s = 1.0", lambda t: 1 - 0.3 * np.minimum(t - 1.0, 1.0)),
    "sine": (
        "mean = 0.8, amplitude = 0.2, omega_rad_s = 3.0",
        lambda t: np.minimum(0.8 + 0.2 * np.cos(3.0 * t), 1.0),
    ),
    "intermittent": (
        "effectiveness = 0.7, period_s = 0.5, duty = 0.4",
        lambda t: np.where((t - 1.0) % 0.5 < 0.2, 0.7, 1.0),
    ),
}


@pytest.mark.parametrize("kind", PROFILES)
def test_actuator_fault_acts_as_described_and_is_survived(kind: str) -> None:
    keys, expected = PROFILES[kind]
    fault = f'fault=[{{{ELBOW}, kind = "{kind}", {keys}}}]'
    opened = open_session("ur5_elbow_loss", ["duration_s=2.5", fault])
    run, outcome = run_simulation(opened, progress=False)
    assert outcome.end_state == "done"
    assert run.rig is not None
    elbow = run.joints.index("elbow_joint")
    t, rho = run.rig["t"], run.rig["rho"][:, elbow]
    before, after = t < 1.0, t >= 1.0
    assert np.all(rho[before] == 1.0)
    close = np.isclose(rho[after], expected(t[after]), atol=1e-9)
    assert np.mean(~close) < 0.005  # at the edges of "intermittent", by rounding
    assert np.all(run.rig["fault"][after, elbow] == 1.0)
    assert np.all(np.delete(run.rig["rho"], elbow, axis=1) == 1.0)
    assert np.abs(metrics.tracking_error(run)[metrics.running_mask(run)]).max() < 0.1


def test_total_loss_ends_in_a_safe_stop_with_closed_brakes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.mcap"
    fault = 'fault=[{joint = "panda_joint2", start_s = 1.0, kind = "total"}]'
    command = ["simulate", "panda_shoulder_loss", "--set", fault, "--log", str(log), "--json"]
    assert dftc(command) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["end_state"] == "safe stop"
    assert found["reason"].startswith("panda_joint2: ")
    run = read(log)
    assert run.rig is not None
    assert 1.0 < run.rig["t"][-1] < 4.0
    last = {name: values[-3:] for name, values in run.rig.items()}
    assert np.all(last["tau_applied"] == 0.0)
    assert np.all(last["v"] == 0.0)
    assert np.all(last["q"] == last["q"][0])


def test_tabulated_local_terms_track_as_the_exact_ones() -> None:
    settings = ["duration_s=6.0", "fault[0].start_s=3.0"]
    errors = {}
    for terms in ("exact", "tabulated"):
        opened = open_session("ur5_elbow_loss", [*settings, f"control.local_terms={terms}"])
        run, outcome = run_simulation(opened, progress=False)
        assert outcome.end_state == "done"
        errors[terms] = metrics.tracking_error(run)[metrics.running_mask(run)]
    assert not np.array_equal(errors["exact"], errors["tabulated"])
    for joint in range(errors["exact"].shape[1]):
        exact, tabulated = (rms(errors[k][:, joint]) for k in ("exact", "tabulated"))
        assert tabulated == pytest.approx(exact, rel=0.02)
