"""The report of one run: it needs neither network nor Python."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any, Final

from dftc_rt.analysis import page, plots, summary
from dftc_rt.analysis.threshold import residual_threshold
from dftc_rt.analysis.traffic import bus_traffic
from dftc_rt.log.run import Run

THRESHOLD_NOTE: Final = (
    "<p class='dim'>Residual: the torque missing against the healthy model. Beyond the dotted "
    "threshold, half of <code>rho_step</code> times the torque of a healthy drive, it is evidence "
    "for a fault, which has to last; where there is no threshold, ρ cannot be observed.</p>"
)


def write_report(run: Run, metrics: Mapping[str, Any], path: str | Path) -> None:
    """Write the report of a run.

    Args:
        run: The run; its curves are thinned to keep every peak.
        metrics: As :func:`dftc_rt.analysis.metrics.evaluate` returns them; with ``buses``, what
            the rig counted.
        path: HTML file to write.

    Raises:
        LogError: The file cannot be written.
    """
    name = str(metrics["robot"] or "robot")
    threshold = residual_threshold(run)
    buses = bus_traffic(run, metrics.get("buses"))
    parts = [
        f"<h1>{escape(name)}</h1><p class='dim'>{escape(told(metrics))}</p>",
        f"<p class='verdict'>{escape(summary.verdict(metrics))}</p>",
        _table(metrics),
        f"<p class='dim'>{escape(summary.timing_line(metrics))}</p>",
    ]
    if threshold is not None:
        parts.append(THRESHOLD_NOTE)
    for i, joint in enumerate(run.joints):
        parts.append(f"<h2>{escape(joint)}</h2>")
        drawn = plots.joint_figure(run, joint, metrics["faults"], threshold)
        parts.append(page.over_time(drawn, f"joint{i}", [run]))
    parts += ["<h2>Timing</h2>", page.timing_table({"": metrics})]
    parts.append(page.figure(plots.timing_figure({"": run}), "timing"))
    parts += ["<h2>Bus load</h2>", page.bus_table({"": buses}), page.bus_note([buses])]
    if any(len(bus.load) for bus in buses):
        parts.append(page.over_time(plots.load_figure(buses), "load", [run]))
    parts.append("<h2>Events</h2>")
    if run.events:
        parts.append(page.over_time(plots.event_figure(run), "events", [run]))
    parts += [page.events(run), page.scenario(run)]
    page.write_page(path, name, parts)


def told(metrics: Mapping[str, Any]) -> str:
    """Law and length of a run, in a line."""
    control = "fault-tolerant" if metrics["ftc"] else "without fault tolerance"
    return f"{metrics['law']}, {control}, {metrics['duration_s']:.1f} s"


def _table(metrics: Mapping[str, Any]) -> str:
    columns = summary.shown_columns(metrics)
    faulted = {fault["joint"] for fault in metrics["faults"]}
    rows = [
        [name, *(summary.cell(joint[key], form) for _, key, form in columns)]
        for name, joint in metrics["joints"].items()
    ]
    head = ["joint", *(title for title, _, _ in columns)]
    return page.table(head, rows, (name in faulted for name in metrics["joints"]))
