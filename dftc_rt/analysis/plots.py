"""The plotly figures of the report: one per joint, one of timing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from dftc_rt.analysis.decimate import extremes
from dftc_rt.analysis.metrics import tracking_error
from dftc_rt.log.run import Run

F64 = NDArray[np.float64]

BLUE, ORANGE, GREEN, RED, GREY = "#3b7dd8", "#e0862b", "#3a9d5d", "#d1495b", "#8a8f98"
_POINTS: Final = 2400  # per curve: a 60 s log of 7 joints stays under 8 MB
_BINS: Final = 60


def joint_figure(run: Run, joint: str, faults: Sequence[Mapping[str, Any]]) -> go.Figure:
    """Tracking error, effectiveness and torque of one joint over the run.

    Args:
        run: The run.
        joint: Which of its joints.
        faults: As listed in the metrics; this joint's are shaded.
    """
    i = run.joints.index(joint)
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.04)
    t, cycle = run.cycle["t"], run.cycle
    _line(figure, 1, t, tracking_error(run)[:, i] * 1e3, "error", BLUE)
    _band(figure, t, cycle["rho_hat"][:, i], cycle["rho_std"][:, i])
    _line(figure, 2, t, cycle["rho_hat"][:, i], "ρ̂", BLUE)
    if run.rig is not None:
        _line(figure, 2, run.rig["t"], run.rig["rho"][:, i], "ρ (true)", GREY, "dash")
    _line(figure, 3, t, cycle["tau_law"][:, i], "law", GREEN)
    _line(figure, 3, t, cycle["tau_cmd"][:, i], "sent", ORANGE)
    if run.rig is not None:
        _line(figure, 3, run.rig["t"], run.rig["tau_applied"][:, i], "applied", GREY, "dot")
    for fault in faults:
        if fault["joint"] == joint and len(t) and fault["start_s"] < t[-1]:
            end = min(fault["end_s"], float(t[-1]))
            figure.add_vrect(x0=fault["start_s"], x1=end, fillcolor=RED, opacity=0.08, line_width=0)
    for row, title in enumerate(("error (mrad)", "effectiveness", "torque (Nm)"), start=1):
        figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="t (s)", row=3, col=1)
    return _styled(figure, 620)


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
