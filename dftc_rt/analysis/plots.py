"""The plotly figures of the report: one per joint, of events and load over time, and of timing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from dftc_rt.analysis.curves import (
    BLUE,
    F64,
    GREEN,
    GREY,
    ORANGE,
    POINTS,
    PURPLE,
    RED,
    band,
    line,
    small,
    strip,
    styled,
)
from dftc_rt.analysis.metrics import FAULT_STATE, tracking_error
from dftc_rt.analysis.timing import percentiles_us
from dftc_rt.analysis.traffic import BusTraffic
from dftc_rt.log.run import Run

_BINS: Final = 60
_EVENTS: Final = 500  # of each severity
SEVERITIES: Final = ("debug", "info", "warning", "error")
TIMES: Final = (("lateness", BLUE), ("compute", GREEN), ("exchange", ORANGE))
PERCENTILES: Final = {"p50": "p50", "p99": "p99", "p999": "p99.9", "max": "max"}
"""Key of a percentile, and how it is shown."""


def joint_figure(
    run: Run, joint: str, faults: Sequence[Mapping[str, Any]], threshold: F64 | None = None
) -> go.Figure:
    """Tracking error, effectiveness, verdict, torque and residual of one joint over the run.

    Args:
        run: The run.
        joint: Which of its joints.
        faults: As listed in the metrics; this joint's are shaded.
        threshold: Of the residual, shape ``(K, n)``, Nm; None: it has none.
    """
    i = run.joints.index(joint)
    figure = make_subplots(
        rows=5, cols=1, shared_xaxes=True, vertical_spacing=0.03,
        row_heights=[0.25, 0.25, 0.05, 0.25, 0.2],
    )  # fmt: skip
    t, cycle = run.cycle["t"], run.cycle
    line(figure, 1, t, shown_error(run, i), "error", BLUE)
    band(figure, 2, t, cycle["rho_hat"][:, i], cycle["rho_std"][:, i])
    line(figure, 2, t, cycle["rho_hat"][:, i], "ρ̂", BLUE)
    if run.rig is not None:
        line(figure, 2, run.rig["t"], run.rig["rho"][:, i], "ρ (true)", GREY, "dash")
    strip(figure, 3, t, cycle["verdict"][:, i])
    line(figure, 4, t, cycle["tau_law"][:, i], "law", GREEN)
    line(figure, 4, t, cycle["tau_cmd"][:, i], "sent", ORANGE)
    if run.rig is not None:
        line(figure, 4, run.rig["t"], run.rig["tau_applied"][:, i], "applied", GREY, "dot")
    line(figure, 5, t, cycle["residual"][:, i], "residual", BLUE)
    if threshold is not None:
        limits(figure, 5, t, threshold[:, i], POINTS // 2)
    shade(figure, faults, joint, t)
    titles = ("error (mrad)", "effectiveness", "", "torque (Nm)", "residual (Nm)")
    for row, title in enumerate(titles, start=1):
        figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="t (s)", row=5, col=1)
    figure = styled(figure, 820)
    return figure.update_yaxes(row=3, col=1, visible=False, range=[-1, 1], fixedrange=True)


def shown_error(run: Run, joint: int) -> F64:
    """Tracking error of a joint, mrad, shape ``(K,)``; NaN where the drives are off."""
    error = tracking_error(run)[:, joint] * 1e3
    return np.where(run.cycle["state"] == FAULT_STATE, np.nan, error)


def limits(
    figure: go.Figure,
    row: int,
    t: F64,
    threshold: F64,
    points: int,
    name: str = "threshold",
    colour: str = RED,
) -> None:
    """A threshold on both sides of zero, shape ``(K,)``; a gap where there is none."""
    for sign in (1.0, -1.0):
        line(
            figure, row, t, sign * threshold, name, colour, "dot", points=points,
            legend=sign > 0.0,
        )  # fmt: skip


def shade(figure: go.Figure, faults: Sequence[Mapping[str, Any]], joint: str, t: F64) -> None:
    """Mark the time of this joint's faults in every row.

    Args:
        figure: Where to.
        faults: As listed in the metrics.
        joint: Whose.
        t: Times of the run, (K,), s.
    """
    for fault in faults:
        if fault["joint"] == joint and len(t) and fault["start_s"] < t[-1]:
            end = min(fault["end_s"], float(t[-1]))
            figure.add_vrect(x0=fault["start_s"], x1=end, fillcolor=RED, opacity=0.08, line_width=0)


def event_figure(run: Run) -> go.Figure:
    """Events over time, a line for each source; their texts on hovering."""
    colours = (GREY, BLUE, ORANGE, RED)
    figure = go.Figure()
    for level, (name, colour) in enumerate(zip(SEVERITIES, colours, strict=True)):
        events = [event for event in run.events if event.severity == level][:_EVENTS]
        if events:
            figure.add_scatter(
                x=[event.t for event in events],
                y=[event.source for event in events],
                text=[escape(event.text) for event in events],
                hovertemplate="%{x:.3f} s: %{text}",
                mode="markers",
                marker={"color": colour, "size": 9},
                name=name,
            )
    figure.update_xaxes(title_text="t (s)")
    return styled(figure, 220).update_layout(hovermode="closest")


def load_figure(buses: Sequence[BusTraffic]) -> go.Figure:
    """Load of each bus over time, percent, of those whose frames were logged."""
    figure = make_subplots(rows=1, cols=1)
    colours = (BLUE, ORANGE, GREEN, PURPLE, RED, GREY)
    for k, bus in enumerate(buses):
        line(figure, 1, bus.t, 100 * bus.load, bus.name, colours[k % len(colours)])
    figure.update_xaxes(title_text="t (s)")
    figure.update_yaxes(title_text="load (%)", rangemode="tozero")
    return styled(figure, 260)


def timing_figure(runs: Mapping[str, Run]) -> go.Figure:
    """Histograms of lateness, update and exchange, µs, on a logarithmic count.

    A mark on each curve is at a percentile of it.

    Args:
        runs: By label; that of a single one is not shown.
    """
    figure = go.Figure()
    for (label, run), dash in zip(runs.items(), ("solid", "dash", "dot", "dashdot"), strict=False):
        for name, colour in TIMES:
            told = name if len(runs) == 1 else f"{name} {label}"
            _histogram(figure, run.cycle[name], told, {"color": colour, "dash": dash})
    figure.update_xaxes(type="log", title_text="µs")
    figure.update_yaxes(type="log", title_text="cycles")
    return styled(figure, 360).update_layout(hovermode="closest")


def _histogram(figure: go.Figure, seconds: F64, name: str, style: Mapping[str, str]) -> None:
    values = seconds[np.isfinite(seconds)] * 1e6
    if not len(values) or not values.any():
        return
    low = max(1e-1, float(values[values > 0].min(initial=1.0)))
    high = max(10 * low, float(values.max()))
    edges = np.logspace(math.log10(low), math.log10(high) + 1e-9, _BINS + 1)
    count, _ = np.histogram(np.maximum(values, low), edges)
    x = np.repeat(edges, 2)[1:-1]
    figure.add_scatter(
        x=small(x), y=np.repeat(count, 2).astype(np.int32), name=name, line=style, legendgroup=name
    )
    marks = {PERCENTILES[key]: value for key, value in percentiles_us(seconds).items() if value}
    at = np.maximum(np.array(list(marks.values())), low)
    bins = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, _BINS - 1)
    figure.add_scatter(
        x=at, y=np.maximum(count[bins], 1), text=list(marks), name=f"{name}, percentiles",
        mode="markers+text", textposition="top center", legendgroup=name, showlegend=False,
        marker={"color": style["color"], "size": 7}, textfont={"color": style["color"]},
        hovertemplate="%{text}: %{x:.1f} µs",
    )  # fmt: skip
