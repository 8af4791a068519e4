"""What is measured, on runs made of arrays."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.analysis.faults import FaultSpec
from dftc_rt.benchmark import measure as measuring
from dftc_rt.benchmark.measure import Drives, beyond_authority, measure, wrong_gain_s
from dftc_rt.control.signals import ACTUATOR_LOSS, ANOMALY, NAMES
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]
H = 1e-3
T = np.arange(8000) * H
FAULT = FaultSpec("a", "loss", 3.0, 1e9, 0.6)
SCENARIO = """\
name = "x"
seed = 1
[robot]
name = "ur5"
[control]
law = "dftc"
"""
TABLE = '[[fault]]\njoint = "a"\nkind = "loss"\nstart_s = 3.0\neffectiveness = 0.6\n'
DRIVES = Drives(
    H, np.zeros(2, dtype=np.int64), np.zeros(2), np.array([100.0, 50.0]), np.full(2, 0.5),
    np.full(2, 10.0), np.full(2, 8.0),
)  # fmt: skip


def made(scenario: str = SCENARIO, **rows: F64) -> Run:
    """A run of two joints without error, ρ̂ = 1, 20 Nm and 10 Nm."""
    cycle = {name: np.zeros((len(T), 2)) for name in NAMES}
    cycle |= {name: np.zeros(len(T)) for name in ("lateness", "compute", "exchange")}
    cycle |= {"t": T, "state": np.full(len(T), 3.0)}
    cycle["rho_hat"] = np.ones((len(T), 2))
    cycle["tau_cmd"] = np.broadcast_to([20.0, 10.0], (len(T), 2)).copy()
    rig = {"t": T, "rho": np.ones((len(T), 2)), "fault": np.zeros((len(T), 2))}
    rig["rho"][T >= 3.0 - 1e-9, 0] = 0.6 if "fault" in scenario else 1.0
    cycle |= rows
    return Run(("a", "b"), cycle, rig, (), scenario, torque_limit=(100.0, 50.0))


def faulty() -> Run:
    """Anomaly after 50 ms, loss after 400 ms, ρ̂ then 0.62 with a std of 0.015; error 2 mrad."""
    run = made(SCENARIO + TABLE)
    verdict, rho = run.cycle["verdict"], run.cycle["rho_hat"]
    verdict[T >= 3.05 - 1e-9, 0] = ANOMALY
    verdict[T >= 3.4 - 1e-9, 0] = ACTUATOR_LOSS
    rho[T >= 3.4 - 1e-9, 0] = 0.62
    run.cycle["rho_std"][:] = 0.015
    run.cycle["observable"][:] = 1.0
    run.cycle["qd"][:, 0] = 2e-3
    run.cycle["qd"][:, 1] = 0.3e-3
    run.cycle["tau_cmd"][T >= 3.4, 0] = 33.0
    return run


def twin() -> Run:
    run = made()
    run.cycle["qd"][:, 0] = 1e-3
    run.cycle["qd"][:, 1] = 0.2e-3
    return run


def measured(run: Run) -> dict[str, Any]:
    true = np.where(T >= 3.0 - 1e-9, 0.6, 1.0)
    return measure(run, twin(), "a", true, DRIVES, "attributed")


def test_a_case_in_numbers() -> None:
    found = measured(faulty())
    assert found["anomaly_delay_s"] == pytest.approx(0.05)
    assert found["attribution_delay_s"] == pytest.approx(0.4)
    assert found["rmse_mrad"] == pytest.approx(2.0)
    assert found["rmse_twin_mrad"] == pytest.approx(1.0)
    assert found["other_joint"] == "b"
    assert found["other_mrad"] == pytest.approx(0.3)
    assert found["other_twin_mrad"] == pytest.approx(0.2)
    assert found["effort"] == pytest.approx(33.0 / 20.0, rel=1e-3)
    both = np.hypot(0.33, 0.2) / np.hypot(0.2, 0.2)
    assert found["effort_all"] == pytest.approx(both, rel=1e-3)
    assert found["within_2_std"] == 1.0
    assert found["std_over_rmse"] == pytest.approx(0.75)
    assert found["std_samples"] == pytest.approx(4100, abs=2)  # from 3.9 s on
    assert found["beyond"] is False
    assert found["stop_s"] is None
    assert found["false_alarms"] == 0
    assert found["wrong_gain_s"] == 0.0


def test_evidence_by_its_definition() -> None:
    found = measured(faulty())
    # 8 Nm are missing: 32 / (0.25 * 10) a sample, in units of 8: 1.6, once the filter has risen
    assert found["evidence_150ms"] == pytest.approx(1.6 * 150, rel=0.15)
    rise = (1.0 - np.exp(-80.0 * H * np.arange(1, 100))) ** 2
    for key, evidence in (("anomaly_information_s", 3.0), ("attribution_information_s", 10.0)):
        expected = np.flatnonzero(np.cumsum(1.6 * rise) >= evidence)[0] * H
        assert found[key] == pytest.approx(expected, abs=1.1e-3)
    assert found["distinct_information_s"] == pytest.approx(0.4, abs=0.02)  # when it changes
    assert found["need_s"] == 0.0


def test_samples_outside_two_standard_deviations_and_not_observable() -> None:
    run = faulty()
    run.cycle["rho_std"][T >= 6.0 - 1e-9, 0] = 0.005
    run.cycle["observable"][T >= 7.0 - 1e-9, 0] = 0.0
    found = measured(run)
    assert found["std_samples"] == pytest.approx(3100, abs=2)
    assert found["within_2_std"] == pytest.approx(2100 / 3100, abs=1e-3)


def test_a_run_that_is_stopped() -> None:
    run = faulty()
    run.cycle["state"][T >= 3.9 - 1e-9] = 5.0
    found = measured(run)
    assert found["stop_s"] == pytest.approx(0.9)
    assert "within_2_std" not in found  # no sample from 0.5 s after the attribution on


def test_coming_to_rest_at_the_end_is_no_safe_stop() -> None:
    run = faulty()
    run.cycle["state"][T >= 7.5] = 7.0
    run.cycle["state"][T >= 7.9] = 6.0  # the drives are off
    assert measured(run)["stop_s"] is None


def test_a_joint_that_needs_no_torque_for_a_while() -> None:
    run = faulty()
    run.cycle["tau_cmd"][(T > 2.5) & (T < 3.2), 0] = 0.1
    assert measured(run)["need_s"] == pytest.approx(0.2, abs=5e-3)


def test_the_worst_of_the_others_is_that_with_the_largest_factor() -> None:
    def metrics(error: float | None, twin: float) -> dict[str, float | None]:
        return {"rmse_faulty_mrad": error, "rmse_twin_mrad": twin}

    joints = {
        "a": metrics(90.0, 1.0), "b": metrics(3.0, 2.0), "c": metrics(0.4, 0.1),
        "d": metrics(5.0, 4.0), "e": metrics(None, 1.0), "f": metrics(7.0, 0.0),
    }  # fmt: skip
    assert measuring.worst_other(joints, {"a"}) == {
        "other_joint": "c", "other_mrad": 0.4, "other_twin_mrad": 0.1,
    }  # fmt: skip
    assert measuring.worst_other(joints, set(joints)) == {}


def test_load_is_that_of_the_faulty_window() -> None:
    run = made()
    run.cycle["tau_cmd"][T < 3.4, 0] = 90.0
    assert measuring.torque_share(run, DRIVES) == pytest.approx([0.2, 0.2])


def test_beyond_authority_for_more_than_a_hundredth_of_the_time() -> None:
    needed = np.full(1000, 50.0)
    rho = np.full(1000, 0.6)
    assert not beyond_authority(needed, rho, 100.0)
    needed[:10] = -70.0
    assert not beyond_authority(needed, rho, 100.0)
    needed[10] = 70.0
    assert beyond_authority(needed, rho, 100.0)
    assert not beyond_authority(needed, np.zeros(1000), 100.0)  # a total loss is no question of it


def test_a_wrong_gain_is_one_on_a_healthy_joint() -> None:
    run = made(SCENARIO + TABLE)
    run.cycle["rho_hat"][:, :] = 0.8
    run.cycle["verdict"][(T >= 2.0) & (T < 2.5), 0] = ACTUATOR_LOSS  # before its fault
    run.cycle["verdict"][T >= 5.0, 0] = ACTUATOR_LOSS  # in it
    run.cycle["verdict"][(T >= 6.0) & (T < 6.2), 1] = ACTUATOR_LOSS  # of another joint
    assert wrong_gain_s(run, [FAULT], "attributed", H) == pytest.approx(0.7, abs=3e-3)
    assert wrong_gain_s(run, [FAULT], "always", H) == pytest.approx(3.0 + 8.0, abs=3e-3)
    assert wrong_gain_s(run, [FAULT], "none", H) == 0.0
    run.cycle["rho_hat"][:, :] = 0.95
    assert wrong_gain_s(run, [FAULT], "always", H) == 0.0


def test_after_the_end_of_a_fault_there_is_a_second_of_grace() -> None:
    run = made(SCENARIO + TABLE)
    run.cycle["rho_hat"][:, 0] = 0.8
    run.cycle["verdict"][T >= 4.0, 0] = ACTUATOR_LOSS
    ends = dataclasses.replace(FAULT, end_s=5.0)
    assert wrong_gain_s(run, [ends], "attributed", H) == pytest.approx(2.0, abs=3e-3)
