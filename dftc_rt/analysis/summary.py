"""The metrics in words and as a table for the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from rich import box
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

COLUMNS: Final = (
    ("healthy\nmrad", "rmse_healthy_mrad", ".2f"),
    ("fault\nmrad", "rmse_faulty_mrad", ".2f"),
    ("twin\nmrad", "rmse_twin_mrad", ".2f"),
    ("peak\nmrad", "peak_after_fault_mrad", ".1f"),
    ("ρ̂ off\nRMS", "rho_rmse", ".3f"),
    ("settle\ns", "rho_settle_s", ".2f"),
    ("detect\ns", "detection_delay_s", ".3f"),
    ("false\nalarms", "false_alarms", "d"),
    ("torque\nNm", "torque_rms_nm", ".1f"),
    ("sat.\n%", "saturated_fraction", "%"),
)
"""Heading, key of the joint's metrics, format."""


def verdict(metrics: Mapping[str, Any]) -> str:
    """What the run shows, in one sentence.

    Args:
        metrics: As :func:`dftc_rt.analysis.metrics.evaluate` returns them.
    """
    end = _END.get(metrics["end_state"], f"ended: {metrics['end_state']}")
    if metrics["reason"] and metrics["end_state"] != "interrupted":
        end += f" ({metrics['reason']})"
    told = [_told(fault, metrics["joints"][fault["joint"]]) for fault in _begun(metrics)]
    alarms = sum(joint["false_alarms"] for joint in metrics["joints"].values())
    if not told:
        told = ["no joint had a fault"]
        errors = [joint["rmse_healthy_mrad"] for joint in metrics["joints"].values()]
        known = [error for error in errors if error is not None]
        if known:
            told.append(f"tracking error up to {max(known):.2f} mrad RMS")
    if alarms:
        told.append(f"{alarms} false alarm{'s' if alarms > 1 else ''}")
    return f"The run {end}: {'; '.join(told)}."


_END: Final = {
    "done": "went to its end",
    "interrupted": "was interrupted",
    "safe stop": "ended in a safe stop",
    "failed": "failed",
    "cut off": "is cut off: its log ends while the controller was at work",
}


def _begun(metrics: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The faults on joints of the robot that began while the run lasted."""
    return [
        fault
        for fault in metrics["faults"]
        if fault["joint"] in metrics["joints"] and fault["start_s"] < metrics["duration_s"]
    ]


def _told(fault: Mapping[str, Any], joint: Mapping[str, Any]) -> str:
    what = fault["kind"].replace("_", " ")
    if fault["effectiveness"] is not None:
        what = f"{what} to {100 * fault['effectiveness']:.0f} %"
    parts = [f"{fault['joint']} ({what} at {fault['start_s']:.2f} s)"]
    delay = joint["detection_delay_s"]
    parts.append("was not detected" if delay is None else f"was detected after {delay:.2f} s")
    if joint["rmse_faulty_mrad"] is not None:
        parts.append(f"and tracked to {joint['rmse_faulty_mrad']:.2f} mrad RMS in the fault")
        if joint["rmse_twin_mrad"] is not None:
            parts.append(f"against {joint['rmse_twin_mrad']:.2f} without it")
    return " ".join(parts)


def cell(value: float | None, form: str) -> str:
    """One number of the table; a dash for what does not apply."""
    if value is None:
        return "–"
    return f"{100 * value:.1f}" if form == "%" else format(value, form)


def shown_columns(metrics: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """The columns in which any joint has a number."""
    joints = metrics["joints"].values()
    return [column for column in COLUMNS if any(joint[column[1]] is not None for joint in joints)]


def timing_line(metrics: Mapping[str, Any]) -> str:
    """Cycles, overruns and the percentiles of what a cycle took.

    In lock-step no tick is ever late, and lateness and overruns mean nothing.
    """
    lockstep = metrics["lateness_us"]["max"] == 0.0
    rest = "in lock-step" if lockstep else f"{metrics['overruns']} overruns"
    texts = [f"{metrics['cycles']} cycles{' ' if lockstep else ', '}{rest}"]
    for key, name in (("lateness_us", "lateness"), ("compute_us", "update"),
                      ("exchange_us", "exchange")):  # fmt: skip
        values = metrics[key]
        if values["max"] is not None and not (lockstep and key == "lateness_us"):
            numbers = " / ".join(f"{values[p]:.0f}" for p in ("p50", "p99", "p999", "max"))
            texts.append(f"{name} {numbers}")
    return "; ".join(texts) + (" µs (p50 / p99 / p99.9 / max)" if len(texts) > 1 else "")


def show(metrics: Mapping[str, Any], console: Console) -> None:
    """Print the summary of a run."""
    console.print(table(metrics))


def table(metrics: Mapping[str, Any]) -> Group:
    """The summary of a run: sentence, a row per joint, timing.

    Args:
        metrics: As :func:`dftc_rt.analysis.metrics.evaluate` returns them.
    """
    columns = shown_columns(metrics)
    faulted = {fault["joint"] for fault in _begun(metrics)}
    grid = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=0)
    grid.add_column("joint", overflow="fold")
    for heading, _, _ in columns:
        grid.add_column(heading, justify="right", min_width=max(map(len, heading.split("\n"))))
    for name, joint in metrics["joints"].items():
        style = "bold yellow" if name in faulted else ""
        cells = (cell(joint[key], form) for _, key, form in columns)
        grid.add_row(Text(name), *cells, style=style)
    return Group(
        Text(verdict(metrics), style="bold"), grid, Text(timing_line(metrics), style="dim")
    )
