"""Metrics against numbers worked out by hand."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from dftc_rt.analysis.faults import RUNNING_STATES, FaultSpec
from dftc_rt.analysis.metrics import evaluate
from dftc_rt.log.ending import ending_text
from dftc_rt.log.run import Run
from dftc_rt.ring import Event
from dftc_rt.rt.supervisor import State

from .conftest import Maker

COUNTS = {"cycles": 1001, "overruns": 4, "skipped": 3, "missed": 2, "refused": 1}
LOSS = FaultSpec("a", "loss", 4.0, 8.0, 0.6)


def between(run: Run, start: float, end: float) -> slice:
    """Cycles with start <= t < end, s."""
    return slice(round(start * 100), round(end * 100))


def joint(run: Run, name: str = "a", *faults: FaultSpec, **options: Any) -> dict[str, Any]:
    found: dict[str, Any] = evaluate(run, faults=faults, **options)["joints"][name]
    return found


def test_states_are_those_of_the_executor() -> None:
    assert RUNNING_STATES == (State.RUN, State.DEGRADED)
    assert (State.SAFE_STOP, State.FAULT, State.FINISH) == (5, 6, 7)


def test_keys_are_the_contracts(make: Maker) -> None:
    found = evaluate(make())
    assert list(found) == [
        "robot", "law", "ftc", "duration_s", "cycles", "overruns", "lateness_us", "compute_us",
        "exchange_us", "end_state", "reason", "faults", "joints",
    ]  # fmt: skip
    assert list(found["lateness_us"]) == ["p50", "p99", "p999", "max"]
    assert list(found["joints"]) == ["a", "b"]
    assert list(found["joints"]["a"]) == [
        "rmse_healthy_mrad", "rmse_faulty_mrad", "rmse_twin_mrad", "peak_after_fault_mrad",
        "rho_rmse", "rho_settle_s", "anomaly_delay_s", "detection_delay_s", "false_alarms",
        "false_alarm_s", "torque_rms_nm", "saturated_fraction",
    ]  # fmt: skip
    json.dumps(found, allow_nan=False)


def test_scenario_names_the_run(make: Maker) -> None:
    text = (
        '[robot]\nname = "panda"\n[control]\nlaw = "dftc"\nftc = false\n'
        '[[fault]]\njoint = "a"\nkind = "loss"\nstart_s = 4.0\neffectiveness = 0.6\n'
    )
    found = evaluate(make(text), extra={"reason": "none", "worst": math.nan})
    assert (found["robot"], found["law"], found["ftc"]) == ("panda", "dftc", False)
    assert found["faults"] == [
        {"joint": "a", "kind": "loss", "start_s": 4.0, "end_s": 1e9, "effectiveness": 0.6}
    ]
    assert (found["reason"], found["worst"]) == ("none", None)


def test_windows_of_the_tracking_error(make: Maker) -> None:
    run = make()
    error = run.cycle["qd"]  # q is zero
    error[between(run, 0, 2)] = 9.0  # blending in: in no window
    error[between(run, 2, 4), 0] = 0.001
    error[between(run, 4, 4.5), 0] = 0.050  # transient: a peak, but in no window
    error[between(run, 4.5, 8), 0] = 0.003
    error[between(run, 8, 10), 0] = 7.0  # after the fault's end
    error[between(run, 2, 4.5), 1] = -0.002
    error[between(run, 4.5, 8), 1] = -0.004
    faulted, other = joint(run, "a", LOSS), joint(run, "b", LOSS)
    assert faulted["rmse_healthy_mrad"] == pytest.approx(1.0)
    assert faulted["rmse_faulty_mrad"] == pytest.approx(3.0)
    assert faulted["peak_after_fault_mrad"] == pytest.approx(50.0)
    assert other["rmse_healthy_mrad"] == pytest.approx(2.0)
    assert other["rmse_faulty_mrad"] == pytest.approx(4.0)
    assert other["peak_after_fault_mrad"] == pytest.approx(4.0)


def test_root_mean_square_not_mean(make: Maker) -> None:
    run = make()
    run.cycle["qd"][between(run, 2, 6), 0] = 0.003
    run.cycle["qd"][between(run, 6, 10), 0] = -0.001
    assert joint(run)["rmse_healthy_mrad"] == pytest.approx(math.sqrt(5.0))


def test_joint_without_fault_is_judged_over_all_the_others_windows(make: Maker) -> None:
    run = make()
    faults = (FaultSpec("a", "loss", 3.0, 4.0), FaultSpec("a", "loss", 6.0, 7.0))
    run.cycle["qd"][:] = 1.0
    run.cycle["qd"][between(run, 3.5, 4), 1] = 0.002
    run.cycle["qd"][between(run, 6.5, 7), 1] = 0.002
    assert joint(run, "b", *faults)["rmse_faulty_mrad"] == pytest.approx(2.0)


def test_joint_with_a_fault_is_judged_over_its_own_window(make: Maker) -> None:
    run = make()
    faults = (FaultSpec("a", "loss", 3.0, 4.0), FaultSpec("b", "loss", 6.0, 7.0))
    run.cycle["qd"][between(run, 3.5, 4)] = 0.001
    run.cycle["qd"][between(run, 6.5, 7)] = 0.005
    assert joint(run, "a", *faults)["rmse_faulty_mrad"] == pytest.approx(1.0)
    assert joint(run, "b", *faults)["rmse_faulty_mrad"] == pytest.approx(5.0)


def test_arming_and_stopping_are_no_tracking(make: Maker) -> None:
    run = make()
    run.cycle["qd"][between(run, 9, 10)] = 5.0
    run.cycle["state"][between(run, 9, 10)] = State.SAFE_STOP
    run.cycle["state"][between(run, 0, 1)] = State.ARM
    run.cycle["verdict"][between(run, 9, 10)] = 1.0
    run.cycle["tau_cmd"][between(run, 0, 1)] = 100.0
    found = evaluate(run)
    assert found["joints"]["a"]["rmse_healthy_mrad"] == 0.0
    assert found["joints"]["a"]["false_alarms"] == 0
    assert found["joints"]["a"]["torque_rms_nm"] == 0.0
    assert found["duration_s"] == pytest.approx(8.0)
    assert found["cycles"] == 1000


def test_twin_is_judged_over_the_same_window(make: Maker) -> None:
    run, twin = make(), make()
    twin.cycle["qd"][:] = 1.0
    twin.cycle["qd"][between(twin, 4.5, 8), 0] = 0.0025
    assert joint(run, "a", LOSS, twin=twin)["rmse_twin_mrad"] == pytest.approx(2.5)
    assert joint(run, "a", LOSS)["rmse_twin_mrad"] is None


def test_without_faults_nothing_is_told_of_them(make: Maker) -> None:
    found = joint(make())
    for key in ("rmse_faulty_mrad", "peak_after_fault_mrad", "rho_rmse", "rho_settle_s",
                "anomaly_delay_s", "detection_delay_s"):  # fmt: skip
        assert found[key] is None


def settling_run(make: Maker) -> Run:
    run = make()
    assert run.rig is not None
    run.rig["rho"][between(run, 4, 8), 0] = 0.6
    run.cycle["rho_hat"][between(run, 4, 8), 0] = 0.6
    run.cycle["rho_hat"][between(run, 4, 5), 0] = 0.9
    run.cycle["rho_hat"][between(run, 5, 8), 0] = 0.62
    return run


def test_effectiveness_error_and_settling(make: Maker) -> None:
    found = joint(settling_run(make), "a", LOSS)
    # 0.5 s of 0.3 and 3 s of 0.02
    assert found["rho_rmse"] == pytest.approx(math.sqrt((50 * 0.09 + 300 * 0.0004) / 350))
    assert found["rho_settle_s"] == pytest.approx(0.99)  # the last sample that is off


def test_settling_needs_a_level_and_an_end(make: Maker) -> None:
    run = settling_run(make)
    assert joint(run, "a", FaultSpec("a", "sine", 4.0, 8.0))["rho_settle_s"] is None
    assert joint(run, "b", LOSS)["rho_settle_s"] is None
    run.cycle["rho_hat"][between(run, 7.99, 8), 0] = 0.7
    assert joint(run, "a", LOSS)["rho_settle_s"] is None
    run.cycle["rho_hat"][between(run, 4, 8), 0] = 0.63
    assert joint(run, "a", LOSS)["rho_settle_s"] == 0.0


def test_laws_without_an_estimate_are_told_nothing_of_it(make: Maker) -> None:
    run = settling_run(make)
    run.cycle["rho_hat"][:] = np.nan
    found = joint(run, "a", LOSS)
    assert (found["rho_rmse"], found["rho_settle_s"]) == (None, None)


def test_without_a_rig_truth_is_unknown(make: Maker) -> None:
    found = joint(make(rig=False), "a", LOSS)
    assert (found["rho_rmse"], found["rho_settle_s"]) == (None, None)
    assert found["rmse_faulty_mrad"] == 0.0


def test_true_effectiveness_is_the_rigs_newest(make: Maker) -> None:
    run = make()
    assert run.rig is not None
    run.rig["t"] += 0.004  # the rig's clock is off by less than a cycle
    run.rig["rho"][:, 0] = np.arange(1000)
    run.cycle["rho_hat"][1:, 0] = np.arange(999)
    assert joint(run, "a", LOSS)["rho_rmse"] == 0.0


def test_a_ramp_starts_below_95_percent(make: Maker) -> None:
    run = make()
    assert run.rig is not None
    ramp = FaultSpec("a", "ramp", 3.0, 1e9, 0.5)
    run.rig["rho"][:, 0] = np.clip(1 - 0.1 * (run.rig["t"] - 3.0), 0.5, 1.0)  # 0.95 at 3.5 s
    run.cycle["verdict"][between(run, 4.51, 10), 0] = 1.0
    found = evaluate(run, faults=[ramp])
    assert found["faults"][0]["start_s"] == pytest.approx(3.51)
    assert found["joints"]["a"]["detection_delay_s"] == pytest.approx(1.0)
    assert found["joints"]["a"]["false_alarms"] == 0


def test_delays_of_the_verdicts(make: Maker) -> None:
    run = make()
    verdict = run.cycle["verdict"]
    verdict[between(run, 4.0, 4.1), 0] = 4.0  # not observable: no anomaly
    verdict[between(run, 4.1, 4.3), 0] = 7.0
    verdict[between(run, 4.3, 8.0), 0] = 1.0
    found = joint(run, "a", LOSS)
    assert found["anomaly_delay_s"] == pytest.approx(0.1)
    assert found["detection_delay_s"] == pytest.approx(0.3)
    assert (found["false_alarms"], found["false_alarm_s"]) == (0, 0.0)
    assert joint(run, "b", LOSS)["detection_delay_s"] is None


def test_what_was_up_before_the_fault_has_not_detected_it(make: Maker) -> None:
    run = make()
    verdict = run.cycle["verdict"]
    verdict[between(run, 3.0, 8.0), 0] = 1.0  # a false alarm that stays
    found = joint(run, "a", LOSS)
    assert (found["anomaly_delay_s"], found["detection_delay_s"]) == (None, None)
    assert found["false_alarms"] == 1
    verdict[between(run, 4.2, 4.5), 0] = 0.0  # it clears, and rises again
    found = joint(run, "a", LOSS)
    assert found["anomaly_delay_s"] == pytest.approx(0.5)
    assert found["detection_delay_s"] == pytest.approx(0.5)
    verdict[:] = 0.0
    verdict[between(run, 4.0, 8.0), 0] = 1.0  # in the fault's first cycle
    assert joint(run, "a", LOSS)["detection_delay_s"] == 0.0


def test_an_anomaly_that_becomes_a_loss_is_detected_then(make: Maker) -> None:
    run = make()
    run.cycle["verdict"][between(run, 3.0, 4.3), 0] = 7.0
    run.cycle["verdict"][between(run, 4.3, 8.0), 0] = 1.0
    found = joint(run, "a", LOSS)
    assert found["anomaly_delay_s"] is None
    assert found["detection_delay_s"] == pytest.approx(0.3)


def test_a_ramp_seen_before_its_onset_is_seen_at_once(make: Maker) -> None:
    run = make()
    assert run.rig is not None
    run.rig["rho"][:, 0] = np.clip(1 - 0.1 * (run.rig["t"] - 3.0), 0.5, 1.0)  # 0.95 at 3.5 s
    run.cycle["verdict"][between(run, 3.2, 10), 0] = 1.0
    found = joint(run, "a", FaultSpec("a", "ramp", 3.0, 1e9, 0.5))
    assert found["detection_delay_s"] == 0.0


def test_a_fault_seen_after_its_end_was_not_detected(make: Maker) -> None:
    run = make()
    run.cycle["verdict"][between(run, 8.2, 8.5), 0] = 1.0
    found = joint(run, "a", LOSS)
    assert found["detection_delay_s"] is None
    assert found["false_alarms"] == 0  # within 1 s of the end


@pytest.mark.parametrize(
    ("name", "start", "end", "count", "seconds"),
    [
        ("b", 5.0, 5.5, 1, 0.5),  # a healthy joint
        ("a", 1.0, 1.25, 1, 0.25),  # before the fault
        ("a", 3.5, 8.5, 1, 0.5),  # before it, and then rightly
        ("a", 9.5, 9.7, 1, 0.2),  # later than 1 s after its end
        ("a", 5.0, 10.0, 0, 1.0),  # latched: entered rightly, left too late
        ("a", 4.0, 9.0, 0, 0.0),
    ],
)
def test_false_alarms(
    make: Maker, name: str, start: float, end: float, count: int, seconds: float
) -> None:
    run = make()
    run.cycle["verdict"][between(run, start, end), "ab".index(name)] = 1.0
    found = joint(run, name, LOSS)
    assert found["false_alarms"] == count
    assert found["false_alarm_s"] == pytest.approx(seconds)


def test_a_payload_called_a_loss_is_a_false_alarm(make: Maker) -> None:
    run = make()
    run.cycle["verdict"][between(run, 5, 6), 0] = 1.0
    found = joint(run, "a", FaultSpec("a", "payload", 4.0, 8.0))
    assert found["anomaly_delay_s"] == pytest.approx(1.0)
    assert found["detection_delay_s"] is None
    assert found["false_alarms"] == 1


@pytest.mark.parametrize("kind", ["payload", "contact", "friction"])
@pytest.mark.parametrize("acts_on", ["", "a"])
def test_what_is_no_actuator_fault_excuses_no_alarm(make: Maker, kind: str, acts_on: str) -> None:
    run = make()
    run.cycle["verdict"][between(run, 4.2, 4.5)] = 3.0  # rightly called a disturbance
    run.cycle["verdict"][between(run, 4.5, 6)] = 1.0  # wrongly a loss
    found = evaluate(run, faults=[FaultSpec(acts_on, kind, 4.0, 8.0)])["joints"]
    for name in ("a", "b"):
        assert found[name]["detection_delay_s"] is None
        assert found[name]["rho_settle_s"] is None
        assert found[name]["false_alarms"] == 1
        assert found[name]["false_alarm_s"] == pytest.approx(1.5)
        assert (found[name]["anomaly_delay_s"] is None) == (name != acts_on)


def test_a_loss_after_a_payload_is_judged_from_its_own_start(make: Maker) -> None:
    run = make()
    assert run.rig is not None
    run.rig["rho"][between(run, 6, 8), 0] = 0.6
    run.cycle["rho_hat"][between(run, 6.2, 8), 0] = 0.6
    run.cycle["verdict"][between(run, 4.1, 4.5), 0] = 2.0
    run.cycle["verdict"][between(run, 6.1, 6.3), 0] = 7.0
    run.cycle["verdict"][between(run, 6.3, 8), 0] = 1.0
    payload, loss = FaultSpec("a", "payload", 4.0, 1e9), FaultSpec("a", "loss", 6.0, 8.0, 0.6)
    found = joint(run, "a", payload, loss)
    assert found["anomaly_delay_s"] == pytest.approx(0.1)
    assert found["detection_delay_s"] == pytest.approx(0.3)
    assert found["rho_settle_s"] == pytest.approx(0.19)
    assert found["false_alarms"] == 0


@pytest.mark.parametrize("kind", ["saturation", "dead_zone"])
def test_what_comes_through_of_a_torque_never_stands_still(make: Maker, kind: str) -> None:
    run = make()
    assert run.rig is not None
    run.rig["rho"][between(run, 4, 8), 0] = 0.7
    run.cycle["rho_hat"][between(run, 4.1, 8), 0] = 0.7
    assert joint(run, "a", FaultSpec("a", "loss", 4.0, 8.0))["rho_settle_s"] is not None
    assert joint(run, "a", FaultSpec("a", kind, 4.0, 8.0))["rho_settle_s"] is None


def test_each_entry_is_one_alarm(make: Maker) -> None:
    run = make()
    for start in (1.0, 2.0, 3.0):
        run.cycle["verdict"][between(run, start, start + 0.1), 1] = 1.0
    found = joint(run, "b")
    assert found["false_alarms"] == 3
    assert found["false_alarm_s"] == pytest.approx(0.3)


def test_torque_and_saturation(make: Maker) -> None:
    run = make(torque_limit=(10.0, 5.0))
    run.cycle["tau_cmd"][:, 0] = 3.0
    run.cycle["tau_cmd"][between(run, 0, 2.5), 0] = -10.0
    found = joint(run)
    assert found["saturated_fraction"] == pytest.approx(0.25)
    assert found["torque_rms_nm"] == pytest.approx(math.sqrt(0.25 * 100 + 0.75 * 9))
    assert joint(make())["saturated_fraction"] is None


def test_timing_is_in_microseconds_and_overruns_are_counted(make: Maker) -> None:
    run = make()
    run.cycle["lateness"][:] = 1e-4
    run.cycle["compute"][10:13] = 0.02  # twice the period
    found = evaluate(run)
    assert found["lateness_us"] == {name: pytest.approx(100.0) for name in
                                    ("p50", "p99", "p999", "max")}  # fmt: skip
    assert found["compute_us"]["max"] == pytest.approx(20_000.0)
    assert found["overruns"] == 3
    assert evaluate(run, overruns=5)["overruns"] == 5
    run.cycle["lateness"][:] = 0.0  # lock-step: the rig waits for us
    assert evaluate(run)["overruns"] == 0


@pytest.mark.parametrize(
    ("states", "events", "end"),
    [
        ((State.RUN, State.FINISH, State.FAULT), (), "done"),
        ((State.RUN, State.SAFE_STOP, State.FAULT), (), "safe stop"),
        ((State.RUN, State.FAULT), (), "safe stop"),
        ((State.RUN, State.FINISH, State.FAULT),
         (Event(9.0, 3, "controller", "quick stop: drive fault"),), "safe stop"),
        ((State.RUN, State.SAFE_STOP),
         (Event(9.0, 3, "controller", "safe stop: stop requested by the operator"),),
         "interrupted"),
        ((State.RUN,), (), "cut off"),
    ],
)  # fmt: skip
def test_how_the_run_ended(
    make: Maker, states: tuple[State, ...], events: tuple[Event, ...], end: str
) -> None:
    run = make(events=events)
    run.cycle["state"][-len(states) :] = states
    assert evaluate(run)["end_state"] == end
    assert evaluate(run, end_state="done")["end_state"] == "done"


@pytest.mark.parametrize(
    ("events", "end_state", "reason"),
    [
        ((Event(8.0, 3, "controller", "safe stop: a: too far"),
          Event(8.3, 3, "controller", "quick stop: a: no feedback")), "safe stop", "a: too far"),
        ((Event(0.1, 3, "controller", "quick stop: a: drive fault"),), "safe stop",
         "a: drive fault"),
        ((Event(9.9, 3, "launcher", "dftc-controller was killed (SIGKILL)"),), "cut off",
         "dftc-controller was killed (SIGKILL)"),
        ((Event(9.9, 2, "can0", "frame lost"),), "cut off", ""),
        ((Event(9.9, 3, "rig", "no matter"),
          Event(9.9, 1, "controller", ending_text("done", "", COUNTS))), "done", ""),
        ((Event(9.9, 1, "controller", ending_text("safe stop", "a: too; far", COUNTS)),),
         "safe stop", "a: too; far"),
    ],
)  # fmt: skip
def test_why_the_run_ended(
    make: Maker, events: tuple[Event, ...], end_state: str, reason: str
) -> None:
    found = evaluate(make(events=events))
    assert (found["end_state"], found["reason"]) == (end_state, reason)


def test_the_executors_own_counts_come_first(make: Maker) -> None:
    run = make(events=(Event(9.9, 1, "controller", ending_text("done", "", COUNTS)),))
    run.cycle["lateness"][:] = 1e-4
    found = evaluate(run)
    assert (found["cycles"], found["overruns"]) == (1001, 4)
    assert evaluate(run, overruns=5)["overruns"] == 5
    elsewhere = make(events=(Event(9.9, 1, "rig", ending_text("done", "", COUNTS)),))
    assert evaluate(elsewhere)["cycles"] == 1000


def test_an_empty_run_has_no_numbers(make: Maker) -> None:
    found = evaluate(make(seconds=0.0), faults=[LOSS])
    assert (found["cycles"], found["duration_s"]) == (0, 0.0)
    assert found["joints"]["a"]["torque_rms_nm"] is None
    json.dumps(found, allow_nan=False)
