"""The report of several runs of a robot side by side: with and without fault tolerance, say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from dftc_rt.analysis import curves, page, plots, summary
from dftc_rt.analysis.faults import scenario_of
from dftc_rt.analysis.report import THRESHOLD_NOTE, told
from dftc_rt.analysis.threshold import residual_threshold
from dftc_rt.analysis.traffic import bus_traffic
from dftc_rt.errors import InputError
from dftc_rt.log.run import Run

F64 = curves.F64

MOST: Final = 4
"""Runs that one page compares."""

_COLOURS: Final = (curves.BLUE, curves.ORANGE, curves.GREEN, curves.PURPLE)
_FILLS: Final = ("59,125,216", "224,134,43", "58,157,93", "143,111,209")
_RATIOS: Final = frozenset(
    ("rmse_healthy_mrad", "rmse_faulty_mrad", "rmse_twin_mrad", "peak_after_fault_mrad",
     "rho_rmse", "torque_rms_nm")
)  # fmt: skip
"""Metrics compared by their ratio; the others by their difference."""


def check_same_robot(runs: Mapping[str, Run]) -> None:
    """Refuse runs of different robots; how long they are may differ.

    Args:
        runs: By what to call them: their files.

    Raises:
        InputError: Joints or URDF of one are not those of the first; or too few or many runs.
    """
    if not 2 <= len(runs) <= MOST:
        raise InputError("logs to compare", f"{len(runs)}", f"2 to {MOST}")
    (first, run), *others = runs.items()
    for name, other in others:
        if other.joints != run.joints:
            found = f"another robot, with the joints {_short(other.joints)}"
            raise InputError(name, found, f"{_short(run.joints)}, as in {first}")
        if run.urdf and other.urdf and run.urdf != other.urdf:
            ours, theirs = (_robot(each) for each in (run, other))
            raise InputError(name, f"another robot, {theirs}", f"{ours}, as in {first}")


def write_comparison(
    runs: Mapping[str, Run], metrics: Mapping[str, Mapping[str, Any]], path: str | Path
) -> None:
    """Write a page that has the numbers and the curves of all runs side by side.

    Args:
        runs: By label.
        metrics: As :func:`dftc_rt.analysis.metrics.evaluate` returns them, by the same labels.
        path: HTML file to write.

    Raises:
        InputError: They are of different robots, or too few or many.
        LogError: The file cannot be written.
    """
    check_same_robot(runs)
    thresholds = {label: residual_threshold(run) for label, run in runs.items()}
    buses = {label: bus_traffic(run, metrics[label].get("buses")) for label, run in runs.items()}
    joints = next(iter(runs.values())).joints
    title = " and ".join(runs)
    parts = [f"<h1>{escape(title)}</h1>"]
    for label, found in metrics.items():
        parts.append(f"<p class='dim'>{escape(label)}: {escape(told(found))}</p>")
        parts.append(f"<p class='verdict'>{escape(label)}: {escape(summary.verdict(found))}</p>")
    parts += [_metrics_table(metrics), _settings(runs)]
    if any(threshold is not None for threshold in thresholds.values()):
        parts.append(THRESHOLD_NOTE)
    for i, joint in enumerate(joints):
        parts.append(f"<h2>{escape(joint)}</h2>")
        parts.append(
            page.over_time(_joint(runs, metrics, thresholds, joint), f"joint{i}", runs.values())
        )
    parts += ["<h2>Timing</h2>", page.timing_table(metrics)]
    parts.append(page.figure(plots.timing_figure(runs), "timing"))
    parts += ["<h2>Bus load</h2>", page.bus_table(buses), page.bus_note(buses.values())]
    for k, (label, found_buses) in enumerate(buses.items()):
        if any(len(bus.load) for bus in found_buses):
            parts.append(f"<h3>{escape(label)}</h3>")
            parts.append(page.over_time(plots.load_figure(found_buses), f"load{k}", runs.values()))
    for k, (label, run) in enumerate(runs.items()):
        parts.append(f"<h2>Events: {escape(label)}</h2>")
        if run.events:
            parts.append(page.over_time(plots.event_figure(run), f"events{k}", runs.values()))
        parts.append(page.events(run))
    parts += [page.scenario(run, f"Scenario: {label}") for label, run in runs.items()]
    page.write_page(path, title, parts)


def _joint(
    runs: Mapping[str, Run],
    metrics: Mapping[str, Mapping[str, Any]],
    thresholds: Mapping[str, F64 | None],
    joint: str,
) -> go.Figure:
    """One joint of all runs: error, effectiveness, a strip of verdicts each, torque, residual."""
    figure = make_subplots(
        rows=5, cols=1, shared_xaxes=True, vertical_spacing=0.03,
        row_heights=[0.25, 0.25, 0.04 * len(runs), 0.2, 0.2],
    )  # fmt: skip
    points = curves.POINTS // len(runs)
    known: set[int] = set()
    for k, (label, run) in enumerate(runs.items()):
        i, t, cycle, colour = run.joints.index(joint), run.cycle["t"], run.cycle, _COLOURS[k]
        curves.line(figure, 1, t, plots.shown_error(run, i), label, colour, points=points)
        mean = cycle["rho_hat"][:, i]
        curves.band(
            figure, 2, t, mean, cycle["rho_std"][:, i], name=f"± 2σ {label}",
            fill=f"rgba({_FILLS[k]},0.2)", points=points // 2,
        )  # fmt: skip
        curves.line(figure, 2, t, mean, f"ρ̂ {label}", colour, points=points)
        if run.rig is not None:
            curves.line(
                figure, 2, run.rig["t"], run.rig["rho"][:, i], f"ρ (true) {label}", colour,
                "dash", points=points // 2,
            )  # fmt: skip
        curves.strip(
            figure, 3, t, cycle["verdict"][:, i], at=float(-k), known=known, points=points // 2
        )
        curves.line(figure, 4, t, cycle["tau_cmd"][:, i], f"sent {label}", colour, points=points)
        curves.line(
            figure, 5, t, cycle["residual"][:, i], f"residual {label}", colour, points=points
        )
        threshold = thresholds[label]
        if threshold is not None:
            plots.limits(figure, 5, t, threshold[:, i], points // 2, f"threshold {label}", colour)
    first, run = next(iter(runs.items()))
    plots.shade(figure, metrics[first]["faults"], joint, run.cycle["t"])
    titles = ("error (mrad)", "effectiveness", "", "torque sent (Nm)", "residual (Nm)")
    for row, title in enumerate(titles, start=1):
        figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="t (s)", row=5, col=1)
    figure = curves.styled(figure, 860)
    return figure.update_yaxes(
        row=3, col=1, fixedrange=True, range=[0.6 - len(runs), 0.4], showgrid=False,
        zeroline=False, tickvals=[-k for k in range(len(runs))], ticktext=list(runs),
    )  # fmt: skip


def _metrics_table(metrics: Mapping[str, Mapping[str, Any]]) -> str:
    """A row for each joint and run, and under each run but the first how it compares."""
    shown = {column for found in metrics.values() for column in summary.shown_columns(found)}
    columns = [column for column in summary.COLUMNS if column in shown]
    (first, base), *others = metrics.items()
    rows: list[list[str]] = []
    marks: list[bool] = []
    for joint, ours in base["joints"].items():
        rows.append([joint, first, *(summary.cell(ours[key], form) for _, key, form in columns)])
        for label, found in others:
            theirs = found["joints"][joint]
            cells = [summary.cell(theirs[key], form) for _, key, form in columns]
            against = [compared(key, form, ours[key], theirs[key]) for _, key, form in columns]
            rows += [["", label, *cells], ["", f"against {first}", *against]]
        faulted = any(f["joint"] == joint for found in metrics.values() for f in found["faults"])
        marks += [faulted] * (1 + 2 * len(others))
    return page.table(["joint", "run", *(title for title, _, _ in columns)], rows, marks)


def compared(key: str, form: str, ours: float | None, theirs: float | None) -> str:
    """A metric of a run against that of the first: × ratio, or a signed difference.

    Args:
        key: Of the metric.
        form: Its format in :data:`dftc_rt.analysis.summary.COLUMNS`.
        ours: Of the first run; None where it does not apply.
        theirs: Of the other.
    """
    if ours is None or theirs is None:
        return "–"
    if key in _RATIOS:
        return f"× {theirs / ours:.3g}" if ours else "–"
    difference = theirs - ours
    return f"{100 * difference:+.1f}" if form == "%" else format(difference, f"+{form}")


def _settings(runs: Mapping[str, Run]) -> str:
    """The keys of the scenarios that differ."""
    flat = [dict(_flat(scenario_of(run, label))) for label, run in runs.items()]
    keys = dict.fromkeys(key for each in flat for key in each)
    rows = [
        [key, *(_value(each.get(key)) for each in flat)]
        for key in keys
        if any(each.get(key) != flat[0].get(key) for each in flat)
    ]
    if not rows:
        return "<p class='dim'>The scenarios are the same.</p>"
    return "<h2>What differs in the scenarios</h2>" + page.table(["key", *runs], rows)


def _flat(node: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in node.items():
        name = f"{path}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        else:
            yield name, value


def _value(value: Any) -> str:
    text = "not set" if value is None else " ".join(str(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


def _robot(run: Run) -> str:
    table = scenario_of(run).get("robot", {})
    return str(table.get("name") or table.get("urdf") or table.get("plant") or "of another URDF")


def _short(joints: Sequence[str]) -> str:
    return ", ".join(joints) if len(joints) <= 3 else f"{joints[0]}, … ({len(joints)} joints)"
