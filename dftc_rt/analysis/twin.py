"""Whether one run can be judged against another: the same one, but for the fault."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from dftc_rt.analysis import faults as fault_windows
from dftc_rt.analysis.timing import period_s
from dftc_rt.errors import InputError
from dftc_rt.log.run import Run

MAY_DIFFER: Final = (
    "name", "duration_s", "fault", "control.ftc", "supervisor", "bus", "executor.overrun",
    "executor.read_budget",
)  # fmt: skip
"""Keys that change neither plant, motion nor law; how long a twin is, its records tell."""

ARMING_S: Final = 0.1  # in real time, runs begin this much apart at most
_SAME: Final = "the same scenario with --set fault=[]"


def check_twin(run: Run, twin: Run, where: str = "twin") -> None:
    """Refuse a twin that is not the run without its faults, or that ends before it.

    Logs without a scenario are compared by joints, rate and time alone.

    Args:
        run: The run to be judged.
        twin: What to judge it against.
        where: What to call the twin: its file.

    Raises:
        InputError: It differs in what moves the robot; the first difference is named.
        LogError: The scenario of either cannot be read.
    """
    if twin.joints != run.joints:
        raise InputError(where, f"joints {', '.join(twin.joints)}", ", ".join(run.joints))
    if run.urdf and twin.urdf and run.urdf != twin.urdf:
        raise InputError(where, "the robot's URDF differs", _SAME)
    ours = fault_windows.scenario_of(run)
    theirs = fault_windows.scenario_of(twin, where)
    if ours and theirs:
        same_file = bool(run.urdf) and run.urdf == twin.urdf  # wherever it lay
        for key, found, expected in _differences(ours, theirs):
            if not (key == "robot.urdf" and same_file):
                raise InputError(where, f"{key} is {_shown(found)}", _shown(expected))
    _check_time(run, twin, where)
    end_s = float(run.cycle["t"][-1]) if len(run.cycle["t"]) else 0.0
    for fault in fault_windows.faults_of(theirs):
        if fault.start_s <= end_s:
            raise InputError(where, f"has a fault itself, on {fault.joint}", _SAME)


def _check_time(run: Run, twin: Run, where: str) -> None:
    periods = [period_s(each.cycle["t"]) for each in (run, twin)]
    if all(periods) and abs(periods[0] - periods[1]) > 1e-6 * periods[0]:
        raise InputError(where, f"{1 / periods[1]:g} cycles a second", f"{1 / periods[0]:g}")
    times = run.cycle["t"][fault_windows.running_mask(run)]
    if not len(times):
        return
    covered = twin.cycle["t"][fault_windows.running_mask(twin)]
    start, end = (covered[0], covered[-1]) if len(covered) else (np.nan, np.nan)
    if not (start <= times[0] + ARMING_S and end >= times[-1] - ARMING_S):
        found = f"runs from {start:.2f} to {end:.2f} s" if len(covered) else "does not run"
        raise InputError(where, found, f"{times[0]:.2f} to {times[-1]:.2f} s, as the log does")


def _differences(
    ours: Mapping[str, Any], theirs: Mapping[str, Any], path: str = ""
) -> Iterator[tuple[str, Any, Any]]:
    """Key path, theirs, ours of what differs and may not."""
    for key in dict.fromkeys((*ours, *theirs)):
        name = f"{path}{key}"
        if name in MAY_DIFFER:
            continue
        mine, other = ours.get(key), theirs.get(key)
        if isinstance(mine, Mapping) and isinstance(other, Mapping):
            yield from _differences(mine, other, f"{name}.")
        elif mine != other:
            yield name, other, mine


def _shown(value: Any) -> str:
    text = "not set" if value is None else " ".join(str(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
