"""What the report's figures are drawn with: thinned curves, bands, strips, one look."""

from __future__ import annotations

from typing import Final

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from dftc_rt.analysis.decimate import extremes
from dftc_rt.control.signals import VERDICTS

F64 = NDArray[np.float64]

BLUE, ORANGE, GREEN, RED, GREY = "#3b7dd8", "#e0862b", "#3a9d5d", "#d1495b", "#8a8f98"
PURPLE: Final = "#8f6fd1"
POINTS: Final = 2400  # per curve: a 60 s log of 7 joints stays under 8 MB
_STRIP: Final = 1500  # spans of the strip of verdicts
_GRAVITY: Final = (0, 4, 2, 3, 6, 5, 7, 1)
"""Verdicts, from those that may be passed over to the one that may not."""
_VERDICT_COLOURS: Final = (
    GREEN, RED, PURPLE, "#4fb3bf", "#b9bec7", "#c061a8", "#6b7280", ORANGE,
)  # fmt: skip


def line(
    figure: go.Figure,
    row: int,
    x: F64,
    y: F64,
    name: str,
    colour: str,
    dash: str = "solid",
    *,
    points: int = POINTS,
    legend: bool = True,
) -> None:
    """A curve in a row of a figure; nothing when it has no number.

    Args:
        figure: Where to.
        row: Which of its rows, from 1.
        x: Shape ``(K,)``.
        y: Shape ``(K,)``; NaN is passed over.
        name: What the legend calls it.
        colour: Its colour.
        dash: ``solid``, ``dash`` or ``dot``.
        points: How many to keep, about.
        legend: Whether the legend has it.
    """
    if not np.isfinite(y).any():
        return
    kept = extremes(y, points)
    style = {"color": colour, "width": 1.3, "dash": dash}
    figure.add_scatter(
        x=small(x[kept]), y=small(y[kept]), name=name, line=style, showlegend=legend, row=row, col=1
    )


def band(
    figure: go.Figure,
    row: int,
    t: F64,
    mean: F64,
    std: F64,
    *,
    name: str = "± 2σ",
    fill: str = "rgba(59,125,216,0.2)",
    points: int = POINTS // 2,
) -> None:
    """Two standard deviations about an estimate, shape ``(K,)`` each; nothing without both."""
    if not np.isfinite(mean + std).any():
        return
    kept = extremes(std, points)
    x, edge = small(t[kept]), {"width": 0}
    low, high = (small((mean + sign * 2 * std)[kept]) for sign in (-1, 1))
    figure.add_scatter(x=x, y=low, line=edge, showlegend=False, hoverinfo="skip", row=row, col=1)
    figure.add_scatter(
        x=x, y=high, line=edge, fill="tonexty", fillcolor=fill, name=name, hoverinfo="skip",
        row=row, col=1,
    )  # fmt: skip


def strip(
    figure: go.Figure,
    row: int,
    t: F64,
    verdict: F64,
    *,
    at: float = 0.0,
    known: set[int] | None = None,
    points: int = _STRIP,
) -> None:
    """The verdict as a strip of colours; of many within its resolution the gravest is shown.

    Args:
        figure: Where to.
        row: Which of its rows, from 1.
        t: Shape ``(K,)``, s.
        verdict: Shape ``(K,)``.
        at: Height of the strip.
        known: Verdicts that the legend has already, added to; None: it has none.
        points: Resolution.
    """
    if not len(t):
        return
    known = set() if known is None else known
    starts = np.unique(np.linspace(0, len(t), points + 1).astype(np.intp)[:-1])
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
            x=small(x), y=small(np.where(np.isnan(x), np.nan, at)), mode="lines",
            line={"color": _VERDICT_COLOURS[number], "width": 14}, name=VERDICTS[number],
            legendgroup=VERDICTS[number], showlegend=number not in known, row=row, col=1,
        )  # fmt: skip
        known.add(number)


def small(values: F64) -> NDArray[np.float32]:
    """Half the bytes: plotly writes the array in base64 as it is."""
    return values.astype(np.float32)


def styled(figure: go.Figure, height: int) -> go.Figure:
    """The look of all figures: nothing in them depends on a light or a dark page."""
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
        hoverlabel={"bgcolor": "rgba(35,39,46,0.92)", "font": {"color": "#f0f2f5"}},
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": GREY},
        hovermode="x unified",
        legend={"orientation": "h", "y": 1.01, "yanchor": "bottom"},
    )
