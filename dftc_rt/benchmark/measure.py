"""What is measured of a run with a fault, beside its twin."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.analysis import faults as windows
from dftc_rt.analysis.faults import GRACE_S, FaultSpec, Mask, running_mask
from dftc_rt.analysis.metrics import evaluate
from dftc_rt.benchmark import information
from dftc_rt.benchmark.cases import Gain
from dftc_rt.benchmark.conditions import BEYOND_SHARE, END_S, FAULT_S
from dftc_rt.config.calibration import Calibration
from dftc_rt.control.signals import ACTUATOR_LOSS
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]

WRONG_GAIN: Final = 0.9
"""ρ̂ below it must not act on a healthy joint."""
_SETTLED_S: Final = 0.5  # from the attribution on, before rho_std is compared with the error
_STOPPED: Final = (5.0, 6.0)  # safe stop, fault: as logged in /cycle
_EARLY_S: Final = 0.15


@dataclass(frozen=True)
class Drives:
    """What is known of the drives and of what the estimator believes, n joints.

    Attributes:
        period_s: Control period, s.
        delay_cycles: Cycles from a command to the SYNC that actuates it, (n,).
        lag_s: Lag of the torque, (n,), s.
        limit: Largest torque, (n,), Nm.
        floor: Residual floor, (n,), Nm.
        inflation: Samples that carry the information of one, (n,).
        threshold: ``threshold_anomaly``, (n,).
    """

    period_s: float
    delay_cycles: NDArray[np.int64]
    lag_s: F64
    limit: F64
    floor: F64
    inflation: F64
    threshold: F64

    @classmethod
    def of(
        cls,
        calibration: Calibration,
        period_s: float,
        delay_cycles: Sequence[int],
        lag_s: float,
        limit: F64,
    ) -> Drives:
        """From a calibration with statistics."""

        def gain(name: str) -> F64:
            return np.array([joint.gains[name] for joint in calibration.joint])

        return cls(
            period_s, np.array(delay_cycles, dtype=np.int64), np.full(len(limit), lag_s), limit,
            gain("floor_nm"), gain("inflation"), gain("threshold_anomaly"),
        )  # fmt: skip

    def delivered(self, run: Run) -> F64:
        """φ of a run: what healthy drives would deliver, (K, n), Nm."""
        return information.delivered_torque(
            run.cycle["tau_cmd"], self.period_s, self.delay_cycles, self.lag_s
        )


def torque_share(twin: Run, drives: Drives) -> F64:
    """RMS command of a twin from 0.5 s after the fault would begin, of the limit, (n,)."""
    t = twin.cycle["t"]
    rows = running_mask(twin) & (t >= FAULT_S + windows.TRANSIENT_S - 1e-9)
    share: F64 = np.sqrt(np.mean(twin.cycle["tau_cmd"][rows] ** 2, axis=0)) / drives.limit
    return share


def beyond_authority(needed: F64, rho: F64, limit: float) -> bool:
    """Whether a joint cannot give the torque that the motion needs, for too much of the time.

    Args:
        needed: Torque of the twin while the fault lasts, filtered, (K,), Nm.
        rho: Effectiveness, (K,).
        limit: Largest torque, Nm.
    """
    if not len(needed) or bool(np.all(rho <= 0.0)):
        return False  # a total loss is a case of its own
    over = np.abs(needed) > limit * rho
    return bool(np.mean(over) > BEYOND_SHARE)


def measure(
    run: Run,
    twin: Run,
    joint: str,
    true: F64,
    drives: Drives,
    gain: Gain,
) -> dict[str, Any]:
    """Columns of a case, by name.

    Args:
        run: The run with the fault.
        twin: The same without it; went to its end.
        joint: The joint that the case is about.
        true: Effectiveness of the joint at the twin's cycles, (K,).
        drives: Of the robot.
        gain: When the law's ρ̂ acts.

    Raises:
        InputError: The twin is another run.
    """
    found = evaluate(run, twin=twin)
    own, i = found["joints"][joint], run.joints.index(joint)
    faults = windows.with_onsets(windows.faults_of(windows.scenario_of(run)), run)
    fault = next(each for each in faults if each.joint == joint)
    columns: dict[str, Any] = {
        "anomaly_delay_s": own["anomaly_delay_s"],
        "attribution_delay_s": own["detection_delay_s"],
        "rho_rmse": own["rho_rmse"],
        "rho_settle_s": own["rho_settle_s"],
        "rmse_mrad": own["rmse_faulty_mrad"],
        "rmse_twin_mrad": own["rmse_twin_mrad"],
        "peak_mrad": own["peak_after_fault_mrad"],
        "false_alarms": sum(each["false_alarms"] for each in found["joints"].values()),
        "false_alarm_s": sum(each["false_alarm_s"] for each in found["joints"].values()),
        "wrong_gain_s": wrong_gain_s(run, faults, gain, drives.period_s),
    }
    columns |= worst_other(found["joints"], {each.joint for each in faults})
    columns |= _effort(run, twin, faults, i, drives)
    columns |= _spread(run, fault, own["detection_delay_s"], i)
    columns |= _information(run, fault, i, drives)
    stop = None if found["end_state"] == "done" else stop_time(run)
    columns["stop_s"] = None if stop is None else stop - fault.start_s
    needed = information.filtered(drives.delivered(twin)[:, i], drives.period_s)
    lasts = windows.within(twin.cycle["t"], [(fault.start_s, min(fault.end_s, END_S))])
    columns["beyond"] = beyond_authority(needed[lasts], true[lasts], float(drives.limit[i]))
    return columns


def wrong_gain_s(run: Run, faults: Sequence[FaultSpec], gain: Gain, period_s: float) -> float:
    """Time with ρ̂ < 0.9 acting on a healthy joint, summed over joints, s.

    A joint is healthy before its fault and from 1 s after its end on, as for false alarms.
    """
    if gain == "none":
        return 0.0
    t, running = run.cycle["t"], running_mask(run)
    total = 0.0
    for i, joint in enumerate(run.joints):
        spans = [
            (each.start_s, each.end_s + GRACE_S)
            for each in windows.actuator_faults(faults)
            if each.joint == joint
        ]
        wrong = running & ~windows.within(t, spans) & (run.cycle["rho_hat"][:, i] < WRONG_GAIN)
        if gain == "attributed":
            wrong &= run.cycle["verdict"][:, i] == ACTUATOR_LOSS
        total += float(np.count_nonzero(wrong)) * period_s
    return total


def stop_time(run: Run) -> float | None:
    """When the safe stop began, s, in a run that did not go to its end; None if it never did."""
    at = np.flatnonzero(np.isin(run.cycle["state"], _STOPPED))
    return float(run.cycle["t"][at[0]]) if len(at) else None


def worst_other(joints: dict[str, dict[str, Any]], faulted: set[str]) -> dict[str, Any]:
    """The healthy joint whose error grew by the largest factor.

    Args:
        joints: Metrics of a run, by joint.
        faulted: Joints with a fault.
    """
    worst, found = -math.inf, {}
    for name, each in joints.items():
        error, twin = each["rmse_faulty_mrad"], each["rmse_twin_mrad"]
        if name in faulted or error is None or not twin:
            continue
        if error / twin > worst:
            worst = error / twin
            found = {"other_joint": name, "other_mrad": error, "other_twin_mrad": twin}
    return found


def _effort(
    run: Run, twin: Run, faults: Sequence[FaultSpec], i: int, drives: Drives
) -> dict[str, Any]:
    def rms(each: Run) -> tuple[float, float]:
        t = each.cycle["t"]
        rows = running_mask(each) & windows.fault_window(t, faults, run.joints[i])
        share = each.cycle["tau_cmd"][rows] / drives.limit
        if not len(share):
            return math.nan, math.nan
        return float(np.sqrt(np.mean(share[:, i] ** 2))), float(np.sqrt(np.mean(share**2)))

    (own, every), (own_twin, every_twin) = rms(run), rms(twin)
    return {"effort": finite(own / own_twin), "effort_all": finite(every / every_twin)}


def _spread(run: Run, fault: FaultSpec, delay: float | None, i: int) -> dict[str, Any]:
    """How well ``rho_std`` tells the error, once the loss is attributed."""
    rho = windows.rho_at(run, run.cycle["t"])
    if delay is None or rho is None:
        return {}
    rows: Mask = (
        running_mask(run)
        & windows.within(run.cycle["t"], [(fault.start_s + delay + _SETTLED_S, fault.end_s)])
        & (run.cycle["observable"][:, i] == 1.0)
        & np.isfinite(run.cycle["rho_std"][:, i])
    )
    if not rows.any():
        return {}
    error = run.cycle["rho_hat"][rows, i] - rho[rows, i]
    std = run.cycle["rho_std"][rows, i]
    rmse = float(np.sqrt(np.mean(error**2)))
    return {
        "within_2_std": float(np.mean(np.abs(error) <= 2.0 * std)),
        "std_over_rmse": finite(float(np.mean(std)) / rmse if rmse else math.inf),
        "std_samples": int(np.count_nonzero(rows)),
    }


def _information(run: Run, fault: FaultSpec, i: int, drives: Drives) -> dict[str, Any]:
    """When the evidence was there, and when the joint needed torque."""
    t = run.cycle["t"]
    rows = running_mask(run) & windows.within(t, [(fault.start_s, fault.end_s)])
    phi = drives.delivered(run)[:, i]
    needed = information.filtered(phi, drives.period_s)[rows]
    since = t[rows] - fault.start_s
    rho = windows.rho_at(run, t[rows])
    needs = np.flatnonzero(np.abs(needed) > drives.floor[i])
    found: dict[str, Any] = {"need_s": float(since[needs[0]]) if len(needs) else None}
    if rho is None or not len(since):
        return found
    missing = (1.0 - rho[:, i]) * phi[rows]
    variance = float(drives.floor[i] ** 2 * drives.inflation[i])
    unit = float(drives.threshold[i])
    known = information.evidence(missing, variance, drives.period_s) / unit
    distinct = information.distinct_evidence(missing, variance, drives.period_s) / unit
    early = np.flatnonzero(since <= _EARLY_S + 1e-9)
    passed = information.time_passed
    return found | {
        "anomaly_information_s": passed(since, known, information.ANOMALY_EVIDENCE),
        "attribution_information_s": passed(since, known, information.ATTRIBUTION_EVIDENCE),
        "distinct_information_s": passed(since, distinct, information.DISTINCT_EVIDENCE),
        "evidence_150ms": float(known[early[-1]]) if len(early) else None,
    }


def finite(value: float) -> float | None:
    """The value; None if it is no number."""
    return value if math.isfinite(value) else None
