"""Both of the paper's examples through the product's own path, at 1 kHz and with noise."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.analysis import metrics
from dftc_rt.cli.main import run as dftc
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.config.load import from_text
from dftc_rt.control.signals import ACTUATOR_LOSS, ANOMALY
from dftc_rt.log.reader import read
from dftc_rt.log.run import Run
from tests.integration.commands import rms

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Example:
    """A scenario; the fault is on the first joint.

    Attributes:
        name: Of the scenario.
        fault_s: When the fault begins, s.
        settle_s: From when on after that the estimate is judged, s.
        bound_mrad: On the tracking error of each joint after that, RMS.
    """

    name: str
    fault_s: float
    settle_s: float
    bound_mrad: tuple[float, float]


EXAMPLES = {
    example.name: example
    for example in (
        Example("paper_example1", 20.0, 1.0, (0.8, 0.3)),
        Example("paper_example2", 4.0, 0.5, (1.1, 3.0)),
        Example("paper_example2_urdf", 4.0, 0.5, (1.1, 3.0)),
    )
}


@dataclass(frozen=True)
class Ran:
    """A run of an example, and how it ended."""

    example: Example
    run: Run
    end_state: str
    reason: str

    def cycles(self, start_s: float, end_s: float) -> NDArray[np.bool_]:
        t = self.run.cycle["t"]
        return metrics.running_mask(self.run) & (t >= start_s) & (t < end_s)

    @property
    def healthy(self) -> NDArray[np.bool_]:
        return self.cycles(2.0, self.example.fault_s)

    @property
    def faulty(self) -> NDArray[np.bool_]:
        return self.cycles(self.example.fault_s + self.example.settle_s, np.inf)

    def tracking_mrad(self, window: NDArray[np.bool_]) -> list[float]:
        return [1e3 * rms(e) for e in metrics.tracking_error(self.run)[window].T]

    def rho_error(self) -> float:
        """RMSE of ρ̂ of the faulted joint, against the rig's truth."""
        assert self.run.rig is not None
        truth = np.interp(self.run.cycle["t"], self.run.rig["t"], self.run.rig["rho"][:, 0])
        return rms((self.run.cycle["rho_hat"][:, 0] - truth)[self.faulty])


def ran(example: Example, *settings: str) -> Ran:
    found, outcome = run_simulation(open_session(example.name, settings), progress=False)
    return Ran(example, found, outcome.end_state, outcome.reason)


@pytest.fixture(scope="module")
def runs() -> dict[str, Ran]:
    return {name: ran(example) for name, example in EXAMPLES.items()}


@pytest.fixture(params=list(EXAMPLES))
def found(request: pytest.FixtureRequest, runs: dict[str, Ran]) -> Ran:
    assert runs[request.param].end_state == "done"
    return runs[request.param]


def test_starts_where_the_paper_starts(found: Ran) -> None:
    run = found.run
    assert run.rig is not None
    assert run.rig["q"][0].tolist() == [1.0, 1.0]
    assert run.rig["v"][0].tolist() == [0.0, 0.0]
    first = int(np.argmax(metrics.running_mask(run)))
    expected = [1.0, 0.0] if found.example.name == "paper_example1" else [0.5, 0.3]
    np.testing.assert_allclose(run.cycle["qd"][first], expected, atol=1e-9)
    np.testing.assert_allclose(run.cycle["q"][first], [1.0, 1.0], atol=5e-4)  # brakes
    duration = 40.0 if found.example.name == "paper_example1" else 10.0
    assert np.count_nonzero(metrics.running_mask(run)) == duration * 1000
    assert run.rig["fault"][:, 1].max() == 0.0


def test_effectiveness_is_estimated_to_two_percent(found: Ran) -> None:
    assert np.count_nonzero(found.faulty) > 5000
    assert found.rho_error() < 0.02
    assert found.run.rig is not None
    truth = found.run.rig["rho"][:, 0]
    lowest = 0.6 if found.example.name == "paper_example1" else 0.8
    assert truth.min() == pytest.approx(lowest, abs=1e-4)
    assert np.all(truth[found.run.rig["t"] < found.example.fault_s - 1e-9] == 1.0)


def test_no_alarm_before_the_fault_and_none_of_the_healthy_joint(found: Ran) -> None:
    verdict = found.run.cycle["verdict"]
    before = found.cycles(0.0, found.example.fault_s)
    assert not np.isin(verdict[before], [ACTUATOR_LOSS, ANOMALY]).any()
    assert not (verdict[:, 1] == ACTUATOR_LOSS).any()
    faulty = found.cycles(found.example.fault_s + 0.1, np.inf)
    assert (verdict[faulty, 0] == ACTUATOR_LOSS).all()  # found within 0.1 s, and kept


def test_tracking_after_the_fault_is_what_it_was_before(found: Ran) -> None:
    before, after = (found.tracking_mrad(w) for w in (found.healthy, found.faulty))
    for joint, bound in enumerate(found.example.bound_mrad):
        assert after[joint] < bound
        # In example 1 the faulted joint stands still, and before the fault nothing moves it.
        if (found.example.name, joint) != ("paper_example1", 0):
            assert after[joint] < 1.15 * before[joint]


def test_closed_form_and_urdf_are_the_same_arm(runs: dict[str, Ran]) -> None:
    closed, urdf = runs["paper_example2"].run.cycle, runs["paper_example2_urdf"].run.cycle
    assert np.abs(closed["q"] - urdf["q"]).max() < 5e-4  # noise is rounded differently
    assert not np.array_equal(closed["q"], urdf["q"])
    assert np.abs(closed["rho_hat"] - urdf["rho_hat"]).max() < 0.02


@pytest.mark.parametrize("name", ["paper_example1", "paper_example2"])
def test_without_the_gain_the_fault_shows(name: str, runs: dict[str, Ran]) -> None:
    without = ran(EXAMPLES[name], "control.ftc=false")
    with_gain = runs[name]
    assert without.end_state == "done"
    bare, held = (r.tracking_mrad(r.faulty)[0] for r in (without, with_gain))
    assert bare > 10.0 * held


def test_physical_pair_does_as_well() -> None:
    found = ran(EXAMPLES["paper_example1"], "robot.plant=pendulums_physical")
    assert found.end_state == "done"
    assert found.rho_error() < 0.02
    verdict = found.run.cycle["verdict"][found.cycles(0.0, 20.0)]
    assert not np.isin(verdict, [ACTUATOR_LOSS, ANOMALY]).any()


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_the_printed_law_at_one_kilohertz_ends_in_a_safe_stop(name: str) -> None:
    found = ran(EXAMPLES[name], "control.law=paper")
    assert found.end_state == "safe stop"
    assert found.run.cycle["t"][-1] < 10.0
    joints = found.run.joints
    assert found.reason.startswith(tuple(f"{joint}: " for joint in joints))
    assert found.run.rig is not None
    assert np.abs(found.run.rig["tau_applied"][-1]).max() < 1e-12


def test_log_says_which_plant_and_can_be_analysed_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, page = tmp_path / "run.mcap", tmp_path / "run.html"
    short = ("--set", "duration_s=1.0", "--set", "fault[0].start_s=0.5")
    assert dftc(["simulate", "paper_example1", "--log", str(log), "--json", *short]) == 0
    said = json.loads(capsys.readouterr().out)
    assert dftc(["analyze", str(log), "--json"]) == 0
    analysed = json.loads(capsys.readouterr().out)
    assert said["robot"] == analysed["robot"] == "pendulums"
    assert analysed["joints"] == said["joints"]
    assert dftc(["report", str(log), "-o", str(page)]) == 0
    assert "pendulum1" in page.read_text()
    run = read(log)
    scenario = from_text(run.scenario)
    assert scenario.robot.plant == "pendulums"
    assert scenario == open_session("paper_example1", short[1::2]).scenario


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("control.local_terms=tabulated",
         "control.local_terms: found 'tabulated' with the closed-form plant 'arm2' "
         "(expected exact)"),
        ("rig.plant.payload_kg=1.0",
         "rig.plant.payload_kg: found 1 with the closed-form plant 'arm2' (expected 0)"),
        ("rig.plant.armature=0.1",
         "rig.plant.armature: found 0.1 with the closed-form plant 'arm2' (expected 0)"),
        ('robot.lock=["joint1"]',
         "robot.lock: found joint1 with the closed-form plant 'arm2' (expected no locked joint)"),
        ("robot.name=arm2", "robot: found name and plant (expected one of name, urdf, plant)"),
        ("robot.plant=wheel",
         "robot.plant: found 'wheel' (expected one of pendulums, pendulums_physical, arm2)"),
    ],
)  # fmt: skip
def test_what_a_closed_form_cannot_do_is_refused_in_one_line(
    setting: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert dftc(["simulate", "paper_example2", "--set", setting]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.strip().count("\n") == 0
