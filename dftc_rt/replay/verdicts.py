"""What a replay says about each joint, beside what the log says."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dftc_rt.analysis import faults as windows
from dftc_rt.control.signals import ANOMALY, HEALTHY, NOT_OBSERVABLE
from dftc_rt.log.run import Run, Signals

F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Told:
    """What the decision said about one joint while the controller ran.

    Attributes:
        anomaly_s: First time of a verdict other than 0 and 4, s; None: none.
        attributed_s: First time of one that names a cause, s.
        verdict: That cause, its number; None: none.
        rho: ρ̂ at the end; None for a law without one.
        rho_std: Its standard deviation.
        alarms_s: Longest time without pause in a verdict other than 0 and 4 while nothing was
            wrong with the joint, s; None where the log has no rig that knows.
    """

    anomaly_s: float | None
    attributed_s: float | None
    verdict: int | None
    rho: float | None
    rho_std: float | None
    alarms_s: float | None


def told(run: Run, cycle: Signals, period_s: float) -> dict[str, Told]:
    """Joint -> what is said about it.

    Args:
        run: The log: its rig knows when a fault was there.
        cycle: Its rows of ``/cycle``, or those of a replay, as many as both have.
        period_s: Control period, s.
    """
    running = np.isin(cycle["state"], windows.RUNNING_STATES)
    t = cycle["t"]
    faulty = _faulty(run, t)
    found = {}
    for i, joint in enumerate(run.joints):
        verdict = cycle["verdict"][:, i]
        raised = running & ~np.isin(verdict, (HEALTHY, NOT_OBSERVABLE))
        named = np.flatnonzero(raised & (verdict != ANOMALY))
        last = np.flatnonzero(running)[-1:]
        found[joint] = Told(
            _first(t, raised),
            float(t[named[0]]) if named.size else None,
            int(verdict[named[0]]) if named.size else None,
            _number(cycle["rho_hat"][last, i]),
            _number(cycle["rho_std"][last, i]),
            None if faulty is None else _longest(raised & ~faulty[:, i]) * period_s,
        )
    return found


def same_commands_until(
    run: Run, cycle: Signals, units: F64, step: F64
) -> tuple[float, str] | None:
    """When and at which joint a replay first commands something else than the log; None: never.

    Args:
        run: The log.
        cycle: Rows of the replay.
        units: Torque that a logged command means to the replay, over the logged one, (n,).
        step: One step of each drive's torque, (n,), Nm.
    """
    logged = run.cycle["tau_cmd"][: len(cycle["t"])] * units
    other = ~(np.abs(cycle["tau_cmd"] - logged) < 0.5 * step)
    rows = np.flatnonzero(other.any(axis=1))
    if not rows.size:
        return None
    at = int(rows[0])
    return float(cycle["t"][at]), run.joints[int(np.flatnonzero(other[at])[0])]


def _faulty(run: Run, t: F64) -> Mask | None:
    """Cycles in which something is wrong with a joint, or was a second ago, (K, n)."""
    if run.rig is None or not len(run.rig["t"]):
        return None
    grace = round(windows.GRACE_S / max(float(np.median(np.diff(run.rig["t"]))), 1e-9))
    active = run.rig["fault"] > 0.0
    lately = np.cumsum(active, axis=0)
    lately[grace:] = lately[grace:] - lately[:-grace].copy()
    at = np.searchsorted(run.rig["t"], t + 1e-9, side="right") - 1
    mask: Mask = (active | (lately > 0))[np.maximum(at, 0)]
    return mask


def _first(t: F64, raised: Mask) -> float | None:
    rows = np.flatnonzero(raised)
    return float(t[rows[0]]) if rows.size else None


def _number(values: F64) -> float | None:
    return float(values[0]) if values.size and math.isfinite(float(values[0])) else None


def _longest(raised: Mask) -> int:
    """Cycles of the longest stretch."""
    edges = np.diff(np.concatenate(([0], raised.astype(np.int8), [0])))
    lengths = np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)
    return int(lengths.max(initial=0))
