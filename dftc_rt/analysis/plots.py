"""The plotly figures of the report: one per joint, of events over time, and of timing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from dftc_rt.analysis.decimate import extremes
from dftc_rt.analysis.metrics import tracking_error
from dftc_rt.control.signals import VERDICTS
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]

BLUE, ORANGE, GREEN, RED, GREY = "#3b7dd8", "#e0862b", "#3a9d5d", "#d1495b", "#8a8f98"
_POINTS: Final = 2400  # per curve: a 60 s log of 7 joints stays under 8 MB
_BINS: Final = 60
_STRIP: Final = 1500  # spans of the strip of verdicts
_EVENTS: Final = 500  # of each severity
SEVERITIES: Final = ("debug", "info", "warning", "error")
_GRAVITY: Final = (0, 4, 2, 3, 6, 5, 7, 1)
"""Verdicts, from those that may be passed over to the one that may not."""
_VERDICT_COLOURS: Final = (
    GREEN, RED, "#8f6fd1", "#4fb3bf", "#b9bec7", "#c061a8", "#6b7280", ORANGE,
)  # fmt: skip


def joint_figure(run: Run, joint: str, faults: Sequence[Mapping[str, Any]]) -> go.Figure:
    """Tracking error, effectiveness, verdict, torque and residual of one joint over the run.

    Args:
        run: The run.
        joint: Which of its joints.
        faults: As listed in the metrics; this joint's are shaded.
    """
    i = run.joints.index(joint)
    figure = make_subplots(
        rows=5, cols=1, shared_xaxes=True, vertical_spacing=0.03,
        row_heights=[0.25, 0.25, 0.05, 0.25, 0.2],
    )  # fmt: skip
    t, cycle = run.cycle["t"], run.cycle
    _line(figure, 1, t, tracking_error(run)[:, i] * 1e3, "error", BLUE)
    _band(figure, t, cycle["rho_hat"][:, i], cycle["rho_std"][:, i])
    _line(figure, 2, t, cycle["rho_hat"][:, i], "ρ̂", BLUE)
    if run.rig is not None:
        _line(figure, 2, run.rig["t"], run.rig["rho"][:, i], "ρ (true)", GREY, "dash")
    _strip(figure, 3, t, cycle["verdict"][:, i])
    _line(figure, 4, t, cycle["tau_law"][:, i], "law", GREEN)
    _line(figure, 4, t, cycle["tau_cmd"][:, i], "sent", ORANGE)
    _line(figure, 5, t, cycle["residual"][:, i], "residual", BLUE)
    if run.rig is not None:
        _line(figure, 4, run.rig["t"], run.rig["tau_applied"][:, i], "applied", GREY, "dot")
    for fault in faults:
        if fault["joint"] == joint and len(t) and fault["start_s"] < t[-1]:
            end = min(fault["end_s"], float(t[-1]))
            figure.add_vrect(x0=fault["start_s"], x1=end, fillcolor=RED, opacity=0.08, line_width=0)
    titles = ("error (mrad)", "effectiveness", "", "torque (Nm)", "residual (Nm)")
    for row, title in enumerate(titles, start=1):
        figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="t (s)", row=5, col=1)
    figure = _styled(figure, 820)
    return figure.update_yaxes(row=3, col=1, visible=False, range=[-1, 1], fixedrange=True)


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
    return _styled(figure, 220).update_layout(hovermode="closest")


def timing_figure(run: Run) -> go.Figure:
    """Histograms of lateness, update and exchange, µs, on a logarithmic count."""
    names = (("lateness", BLUE), ("compute", GREEN), ("exchange", ORANGE))
    figure = go.Figure()
    for name, colour in names:
        values = run.cycle[name]
        values = values[np.isfinite(values)] * 1e6
        if not len(values) or not values.any():
            continue
        low = max(1e-1, float(values[values > 0].min(initial=1.0)))
        high = max(10 * low, float(values.max()))
        edges = np.logspace(math.log10(low), math.log10(high) + 1e-9, _BINS + 1)
        count, _ = np.histogram(np.maximum(values, low), edges)
        x = np.repeat(edges, 2)[1:-1]
        figure.add_scatter(
            x=_small(x), y=np.repeat(count, 2).astype(np.int32), name=name, line_color=colour
        )
    figure.update_xaxes(type="log", title_text="µs")
    figure.update_yaxes(type="log", title_text="cycles")
    return _styled(figure, 320)


def _line(
    figure: go.Figure, row: int, x: F64, y: F64, name: str, colour: str, dash: str = "solid"
) -> None:
    if not np.isfinite(y).any():
        return
    kept = extremes(y, _POINTS)
    line = {"color": colour, "width": 1.3, "dash": dash}
    figure.add_scatter(x=_small(x[kept]), y=_small(y[kept]), name=name, line=line, row=row, col=1)


def _strip(figure: go.Figure, row: int, t: F64, verdict: F64) -> None:
    """The verdict as a strip of colours; of many within its resolution the gravest is shown."""
    if not len(t):
        return
    starts = np.unique(np.linspace(0, len(t), _STRIP + 1).astype(np.intp)[:-1])
    grave = np.array([_GRAVITY.index(v) for v in range(len(_GRAVITY))])
    rank = np.maximum.reduceat(grave[verdict.astype(np.intp)], starts)
    edges = np.flatnonzero(np.diff(rank)) + 1
    begins, ends = np.concatenate(([0], edges)), np.concatenate((edges, [len(starts)]))
    times = np.append(t[starts], t[-1])
    for level in np.unique(rank).tolist():
        number = _GRAVITY[level]
        spans = [(times[a], times[b], np.nan) for a, b in zip(begins, ends, strict=True)
                 if rank[a] == level]  # fmt: skip
        x = np.array(spans).ravel()
        figure.add_scatter(
            x=_small(x), y=_small(np.where(np.isnan(x), np.nan, 0.0)), mode="lines",
            line={"color": _VERDICT_COLOURS[number], "width": 14},
            name=VERDICTS[number], row=row, col=1,
        )  # fmt: skip


def _band(figure: go.Figure, t: F64, mean: F64, std: F64) -> None:
    """Two standard deviations about the estimate."""
    if not np.isfinite(mean + std).any():
        return
    kept = extremes(std, _POINTS // 2)
    x, edge = _small(t[kept]), {"width": 0}
    low, high = (_small((mean + sign * 2 * std)[kept]) for sign in (-1, 1))
    figure.add_scatter(x=x, y=low, line=edge, showlegend=False, hoverinfo="skip", row=2, col=1)
    figure.add_scatter(
        x=x, y=high, line=edge, fill="tonexty", fillcolor="rgba(59,125,216,0.2)", name="± 2σ",
        hoverinfo="skip", row=2, col=1,
    )  # fmt: skip


def _small(values: F64) -> NDArray[np.float32]:
    """Half the bytes: plotly writes the array in base64 as it is."""
    return values.astype(np.float32)


def _styled(figure: go.Figure, height: int) -> go.Figure:
    grid = {"gridcolor": "rgba(128,128,128,0.25)", "zerolinecolor": "rgba(128,128,128,0.4)"}
    figure.update_xaxes(**grid)
    figure.update_yaxes(**grid)
    return figure.update_layout(
        template="none",
        height=height,
        margin={"l": 70, "r": 20, "t": 20, "b": 45},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"color": GREY},
        hovermode="x unified",
        legend={"orientation": "h", "y": 1.06},
    )
