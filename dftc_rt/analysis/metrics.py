"""What a run is judged by. The keys and windows are part of the contract with scripts.

The tracking error of a joint is ``e = q_d - q``. Windows hold only while the controller
runs: arming, and coming to rest at the end or in a safe stop, are no tracking.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.analysis import faults as fault_windows
from dftc_rt.analysis.faults import (
    ACTUATOR_KINDS,
    GRACE_S,
    RESTLESS_KINDS,
    FaultSpec,
    Mask,
    running_mask,
)
from dftc_rt.analysis.timing import percentiles_us, period_s
from dftc_rt.analysis.twin import check_twin
from dftc_rt.control.signals import ACTUATOR_LOSS, HEALTHY, NOT_OBSERVABLE
from dftc_rt.log.ending import ending_of
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]

SAFE_STOP_STATE: Final = 5.0
FAULT_STATE: Final = 6.0
FINISH_STATE: Final = 7.0
ERROR_SEVERITY: Final = 3  # as logged in /events
SETTLE_BAND: Final = 0.05
AT_LIMIT: Final = 0.995  # of the torque limit; drives quantise to 0.1 % of rated torque

METRIC_ROWS: Final = (
    "rmse_healthy_mrad", "rmse_faulty_mrad", "rmse_twin_mrad", "peak_after_fault_mrad",
    "rho_rmse", "rho_settle_s", "anomaly_delay_s", "detection_delay_s", "false_alarms",
    "false_alarm_s", "torque_rms_nm", "saturated_fraction",
)  # fmt: skip


def evaluate(
    run: Run,
    *,
    twin: Run | None = None,
    twin_name: str = "twin",
    faults: Sequence[FaultSpec] | None = None,
    overruns: int | None = None,
    end_state: str | None = None,
    extra: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Metrics of a run, ready for JSON: numbers, texts, None; never NaN.

    Beyond the contract's keys, ``faults`` lists what was judged, a ramp's start moved to
    its onset.

    Args:
        run: The run.
        twin: The same scenario and seed without faults.
        twin_name: What to call the twin where it is refused: its file.
        faults: The faults of the run; None takes them from its scenario and its events.
        overruns: As the executor counted them; None takes them from its last event, or,
            in a log that is cut off, derives them from the records.
        end_state: As the executor told it; None finds it in the same way.
        extra: Further keys of the result, e.g. of the buses.

    Raises:
        LogError: The run's scenario cannot be read.
        InputError: The twin differs from the run in more than its faults.
    """
    if twin is not None:
        check_twin(run, twin, twin_name)
    scenario = fault_windows.scenario_of(run)
    told = fault_windows.all_faults(run, scenario) if faults is None else tuple(faults)
    given = fault_windows.with_onsets(told, run)
    begins = [fault.start_s for fault in told]
    robot, control = scenario.get("robot", {}), scenario.get("control", {})
    cycle, period = run.cycle, period_s(run.cycle["t"])
    running = running_mask(run)
    ending = ending_of(run.events)
    if ending is not None:
        overruns = ending.overruns if overruns is None else overruns
        end_state = ending.end_state if end_state is None else end_state
    end_state = _end_state(run) if end_state is None else end_state
    result: dict[str, Any] = {
        "robot": robot.get("name") or robot.get("urdf") or robot.get("plant"),
        "law": control.get("law"),
        "ftc": control.get("ftc"),
        "duration_s": float(np.count_nonzero(running) and np.ptp(cycle["t"][running]) + period),
        "cycles": len(cycle["t"]) if ending is None else ending.cycles,
        "overruns": _overruns(run, period) if overruns is None else overruns,
        "lateness_us": percentiles_us(cycle["lateness"]),
        "compute_us": percentiles_us(cycle["compute"]),
        "exchange_us": percentiles_us(cycle["exchange"]),
        "end_state": end_state,
        "reason": _reason(run, end_state) if ending is None else ending.reason,
        "faults": [asdict(fault) for fault in given],
        "joints": {joint: _joint(run, twin, given, begins, joint, period) for joint in run.joints},
    }
    clean: dict[str, Any] = _clean(result | dict(extra or {}))
    return clean


def tracking_error(run: Run) -> F64:
    """``q_d - q``, shape ``(K, n)``, rad."""
    return run.cycle["qd"] - run.cycle["q"]


def _joint(
    run: Run,
    twin: Run | None,
    faults: Sequence[FaultSpec],
    begins: Sequence[float],
    joint: str,
    period: float,
) -> dict[str, Any]:
    i = run.joints.index(joint)
    t, running = run.cycle["t"], running_mask(run)
    error = tracking_error(run)[:, i]
    window = running & fault_windows.fault_window(t, faults, joint)
    after = running & fault_windows.fault_window(t, faults, joint, skip_s=0.0)
    own = [fault for fault in faults if fault.joint == joint]
    lossy = fault_windows.actuator_faults(own)
    begun = [pair for pair in zip(faults, begins, strict=True) if pair[0].joint == joint]
    begun_lossy = [pair for pair in begun if pair[0].kind in ACTUATOR_KINDS]
    torque = run.cycle["tau_cmd"][running, i]
    verdict = np.where(running, run.cycle["verdict"][:, i], HEALTHY)
    alarms, alarm_s = _false_alarms(t, verdict, lossy, period)
    rho = fault_windows.rho_at(run, t)
    rho_error = np.full(len(t), np.nan) if rho is None else run.cycle["rho_hat"][:, i] - rho[:, i]
    limit = None if run.torque_limit is None else run.torque_limit[i]
    values: tuple[float | None, ...] = (
        _rms(error[running & fault_windows.healthy_window(t, faults)]) * 1e3,
        _rms(error[window]) * 1e3,
        None if twin is None else _twin_rms(twin, faults, joint) * 1e3,
        np.max(np.abs(error[after]), initial=0.0) * 1e3 if after.any() else None,
        _rms(rho_error[window]),
        _settle(t, rho_error, None if rho is None else rho[:, i], running, lossy),
        _delay(t, ~np.isin(verdict, (HEALTHY, NOT_OBSERVABLE)), begun_lossy or begun),
        _delay(t, verdict == ACTUATOR_LOSS, begun_lossy),
        alarms,
        alarm_s,
        _rms(torque),
        None if limit is None or not len(torque) else np.mean(np.abs(torque) >= AT_LIMIT * limit),
    )
    return dict(zip(METRIC_ROWS, values, strict=True))


def _twin_rms(twin: Run, faults: Sequence[FaultSpec], joint: str) -> float:
    """Error of the fault-free twin over the faulted run's window, rad."""
    mask = running_mask(twin) & fault_windows.fault_window(twin.cycle["t"], faults, joint)
    return _rms(tracking_error(twin)[mask, twin.joints.index(joint)])


def _settle(
    t: F64, error: F64, rho: F64 | None, running: Mask, own: Sequence[FaultSpec]
) -> float | None:
    """From the actuator's first fault to the last time the estimate was off by over 0.05."""
    if not own or rho is None or own[0].kind in RESTLESS_KINDS:
        return None
    span = running & fault_windows.within(t, [(own[0].start_s, own[0].end_s)])
    if not span.any() or rho[span].min() >= 1.0 or not np.isfinite(error[span]).all():
        return None
    off = np.flatnonzero(np.abs(error[span]) > SETTLE_BAND)
    if not len(off):
        return 0.0
    if off[-1] == np.count_nonzero(span) - 1:
        return None
    return float(t[span][off[-1]] - own[0].start_s)


def _delay(t: F64, raised: Mask, begun: Sequence[tuple[FaultSpec, float]]) -> float | None:
    """From the start of the joint's first fault to the first time ``raised`` rises in it.

    What was already raised when the fault began has not detected it: it must clear first.
    A ramp begins before the onset from which its delay counts.
    """
    if not begun:
        return None
    fault, begins = begun[0]
    before = np.concatenate(([False], raised[:-1]))
    hits = t[raised & ~before & fault_windows.within(t, [(begins, fault.end_s)])]
    return max(0.0, float(hits[0] - fault.start_s)) if len(hits) else None


def _false_alarms(
    t: F64, verdict: F64, own: Sequence[FaultSpec], period: float
) -> tuple[int, float]:
    """Entries into, and time in s spent in, verdict 1 where no actuator fault excuses it."""
    spans = [(f.start_s, f.end_s + GRACE_S) for f in own]
    false = ~fault_windows.within(t, spans)
    loss = verdict == ACTUATOR_LOSS
    entered = loss & ~np.concatenate(([False], loss[:-1]))
    return int(np.count_nonzero(entered & false)), float(np.count_nonzero(loss & false) * period)


def _overruns(run: Run, period: float) -> int:
    """Cycles that were still at work when the next tick came; in lock-step none can be.

    By what the cycles took; a few less than the executor counts (:mod:`dftc_rt.log.ending`).
    """
    if not run.cycle["lateness"].any():
        return 0
    busy = run.cycle["lateness"] + run.cycle["compute"] + run.cycle["exchange"]
    return int(np.count_nonzero(busy > period))


def _end_state(run: Run) -> str:
    """How the run ended, from the states it went through and its events."""
    states = set(run.cycle["state"].tolist())
    if any("stop requested by the operator" in event.text for event in run.events):
        return "interrupted"
    if SAFE_STOP_STATE in states or _stops(run):
        return "safe stop"
    if FINISH_STATE in states:
        return "done"
    return "safe stop" if FAULT_STATE in states else "cut off"


def _reason(run: Run, end_state: str) -> str:
    """Why it ended so, from its events; "" when it went to its end, or none tells."""
    if end_state == "done":
        return ""
    if stops := _stops(run):
        return stops[0]
    errors = [event.text for event in run.events if event.severity >= ERROR_SEVERITY]
    return errors[-1] if errors else ""


def _stops(run: Run) -> list[str]:
    """What stopped the run, in order; the first is the reason, later ones follow from it."""
    texts = (event.text.partition("stop: ") for event in run.events)
    return [reason for kind, _, reason in texts if kind in ("safe ", "quick ")]


def _rms(values: F64) -> float:
    """Root mean square of the finite entries; NaN when there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else math.nan


def _clean(node: Any) -> Any:
    """JSON's types only; None for what is not finite."""
    if isinstance(node, Mapping):
        return {str(key): _clean(value) for key, value in node.items()}
    if isinstance(node, (list, tuple)):
        return [_clean(value) for value in node]
    if isinstance(node, np.generic):
        node = node.item()
    if isinstance(node, float) and not math.isfinite(node):
        return None
    return node
