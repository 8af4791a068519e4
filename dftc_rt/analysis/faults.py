"""The faults of a run, and the windows of time over which a run is judged."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import LogError
from dftc_rt.log.run import Run

Mask = NDArray[np.bool_]

ACTUATOR_KINDS: Final = frozenset(
    (
        "loss", "ramp", "sine", "intermittent", "total", "dead_zone", "stuck_torque",
        "lock", "bias", "saturation", "lag",
    )
)  # fmt: skip
"""Faults for which the verdict "actuator loss" is right.

Not so for payload, contact and friction, nor for those of drives as nodes and of sensors: every
motor is healthy, and the verdict a false alarm.
"""

RESTLESS_KINDS: Final = frozenset({"sine", "intermittent", "saturation", "dead_zone"})
"""Effectiveness that never stands still, so an estimate never settles on it."""

RUNNING_STATES: Final = (3.0, 4.0)  # run, degraded: as logged in /cycle
RAMP_ONSET: Final = 0.95  # effectiveness below which a ramp counts as begun
TRANSIENT_S: Final = 0.5  # after the onset, not part of the faulty window
GRACE_S: Final = 1.0  # after a fault's end, in which its verdict may linger
SETTLED_S: Final = 2.0  # the healthy window begins here


@dataclass(frozen=True)
class FaultSpec:
    """One fault as the scenario gives it.

    Attributes:
        joint: Joint it acts on; "" for one that acts on the whole arm.
        kind: As in the scenario file.
        start_s: When it begins, s; for a ramp see :func:`with_onsets`.
        end_s: When it ends, s.
        effectiveness: What is left of the torque in the end; None where that is no number.
    """

    joint: str
    kind: str
    start_s: float
    end_s: float = 1e9
    effectiveness: float | None = None


def actuator_faults(faults: Iterable[FaultSpec]) -> tuple[FaultSpec, ...]:
    """Those that are faults of an actuator."""
    return tuple(fault for fault in faults if fault.kind in ACTUATOR_KINDS)


def scenario_of(run: Run, where: str = "the log") -> dict[str, Any]:
    """The resolved scenario as nested dictionaries; empty when the log has none.

    Raises:
        LogError: It is no TOML.
    """
    try:
        return tomllib.loads(run.scenario)
    except tomllib.TOMLDecodeError as error:
        raise LogError(f"{where}: scenario.toml", str(error), "TOML") from None


def faults_of(scenario: dict[str, Any]) -> tuple[FaultSpec, ...]:
    """The scenario's ``[[fault]]`` tables.

    Raises:
        LogError: A table lacks its kind or a time is no number.
    """
    faults = []
    for k, table in enumerate(scenario.get("fault", ())):
        try:
            left = {"total": 0.0}.get(table["kind"], table.get("effectiveness", table.get("to")))
            faults.append(
                FaultSpec(
                    str(table.get("joint", "")),
                    str(table["kind"]),
                    float(table.get("start_s", 0.0)),
                    float(table.get("end_s", 1e9)),
                    None if left is None else float(left),
                )
            )
        except (KeyError, TypeError, ValueError) as error:
            raise LogError(f"scenario.toml: fault[{k}]", f"wrong: {error}", "a fault") from None
    return tuple(faults)


def all_faults(run: Run, scenario: dict[str, Any]) -> tuple[FaultSpec, ...]:
    """The scenario's faults and those applied at run time, with the ends that they had.

    Raises:
        LogError: As :func:`faults_of`, or an event does not hold what the rig writes.
    """
    faults = faults_of(scenario)
    found = list(faults)
    for event in run.events:
        what, _, text = event.text.partition(": ")
        if event.source != "rig" or what not in ("fault applied", "fault cleared"):
            continue
        try:
            (one,) = faults_of({"fault": [json.loads(text)]})
        except (ValueError, LogError) as error:
            raise LogError("/events", f"'{what}' at {event.t} s: {error}", "a fault") from None
        same = [k for k, old in enumerate(found) if (old.kind, old.joint) == (one.kind, one.joint)]
        for k in same:  # what is applied takes the place of what came before, as a clearing ends it
            ends = one.start_s if what == "fault applied" else one.end_s
            if k >= len(faults) or what == "fault cleared":
                found[k] = replace(found[k], end_s=min(found[k].end_s, ends))
        if what == "fault applied":
            found.append(one)
    return tuple(fault for fault in found if fault.end_s > fault.start_s)


def with_onsets(faults: Iterable[FaultSpec], run: Run) -> tuple[FaultSpec, ...]:
    """The faults with a ramp's start moved to where effectiveness falls below 0.95.

    Judged by what the rig logged; without a rig's log a ramp starts where it is said to.
    """
    return tuple(_with_onset(fault, run) for fault in faults)


def _with_onset(fault: FaultSpec, run: Run) -> FaultSpec:
    if fault.kind != "ramp" or run.rig is None or fault.joint not in run.joints:
        return fault
    t = run.rig["t"]
    rho = run.rig["rho"][:, run.joints.index(fault.joint)]
    begun = t[(t >= fault.start_s) & (t < fault.end_s) & (rho < RAMP_ONSET)]
    return replace(fault, start_s=float(begun[0])) if len(begun) else fault


def running_mask(run: Run) -> Mask:
    """Cycles, shape ``(K,)``, in which the controller follows the reference."""
    return np.isin(run.cycle["state"], RUNNING_STATES)


def within(t: NDArray[np.float64], spans: Iterable[tuple[float, float]]) -> Mask:
    """Whether each time, shape ``(K,)``, s, lies in one of the half-open spans."""
    mask = np.zeros(len(t), np.bool_)
    half = 1e-9  # scheduled times are multiples of the period up to rounding
    for start, end in spans:
        mask |= (t >= start - half) & (t < end - half)
    return mask


def healthy_window(t: NDArray[np.float64], faults: Sequence[FaultSpec]) -> Mask:
    """From 2 s to the first fault of the run."""
    first = min((fault.start_s for fault in faults), default=np.inf)
    return within(t, [(SETTLED_S, first)])


def fault_window(
    t: NDArray[np.float64], faults: Sequence[FaultSpec], joint: str, skip_s: float = TRANSIENT_S
) -> Mask:
    """From ``skip_s`` after a fault of this joint begins to its end.

    For a joint without a fault: the union of the windows of all faults.
    """
    own = [fault for fault in faults if fault.joint == joint] or faults
    return within(t, [(fault.start_s + skip_s, fault.end_s) for fault in own])


def rho_at(run: Run, t: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """True effectiveness at times ``t``, shape ``(K, n)``; None without a rig's log.

    The rig's newest record at each time; the first one before it began.
    """
    if run.rig is None or not len(run.rig["t"]):
        return None
    at = np.searchsorted(run.rig["t"], t + 1e-9, side="right") - 1
    return run.rig["rho"][np.maximum(at, 0)]
