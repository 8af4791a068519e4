"""One self-contained HTML file: its look, light, dark and on paper, and what joins its figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from dftc_rt.analysis import plots, summary
from dftc_rt.analysis.traffic import BusTraffic
from dftc_rt.errors import LogError
from dftc_rt.log.run import Run

_EVENTS: Final = 500  # shown at most
_JOIN: Final = """
const over = [...document.querySelectorAll(".plotly-graph-div.time, .time .plotly-graph-div")];
let joining = false;
for (const one of over) one.on("plotly_relayout", change => {
  if (joining) return;
  const key = Object.keys(change).find(name => /^xaxis\\d*[.](range|autorange)/.test(name));
  if (!key) return;
  const axis = one._fullLayout.xaxis;
  const told = axis.autorange ? {"xaxis.autorange": true} : {"xaxis.range": [...axis.range]};
  joining = true;
  Promise.all(over.filter(other => other !== one).map(other => Plotly.relayout(other, told)))
    .finally(() => { joining = false; });
});
const every = [...document.querySelectorAll(".plotly-graph-div")];
addEventListener("beforeprint", () => {
  for (const one of every) Plotly.relayout(one, {width: 680, autosize: false});
});
addEventListener("afterprint", () => {
  for (const one of every) Plotly.relayout(one, {width: null, autosize: true});
});
"""
"""Zooms the time axes of all figures together, and fits every figure to the paper's width."""

_STYLE: Final = """
:root { color-scheme: light dark; --line: #d5d9e0; --mark: #fff3d6; }
@media (prefers-color-scheme: dark) { :root { --line: #3a3f47; --mark: #4a3d1c; } }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
.verdict { font-size: 1.1rem; font-weight: 600; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .6rem; border-bottom: 1px solid var(--line); text-align: right; }
th:first-child, td:first-child, .events td, .events th { text-align: left; }
tr.fault { background: var(--mark); }
.dim { opacity: .7; }
pre { overflow-x: auto; }
@media print {
  @page { margin: 12mm; }
  :root { color-scheme: light; --line: #d5d9e0; --mark: #fff3d6; print-color-adjust: exact; }
  body { font-size: 11px; max-width: none; margin: 0; padding: 0; }
  .wide { overflow: visible; }
  th, td { padding: .15rem .35rem; }
  h2 { break-after: avoid; }
  .time, tr { break-inside: avoid; }
  .modebar { display: none; }
  pre { white-space: pre-wrap; }
}
"""


def write_page(path: str | Path, title: str, parts: Iterable[str]) -> None:
    """Write a page.

    Args:
        path: HTML file to write.
        title: Of the page.
        parts: Its body, in order.

    Raises:
        LogError: The file cannot be written.
    """
    body = "\n".join(parts)
    text = (
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width'>"
        f"<title>{escape(title)}</title><style>{_STYLE}</style>"
        f"<script>{get_plotlyjs()}</script></head>\n<body>\n{body}\n"
        f"<script>{_JOIN}</script></body></html>\n"
    )
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise LogError(str(path), f"cannot be written: {error.strerror}") from None


def figure(drawn: go.Figure, div: str) -> str:
    """A figure as part of the page; ``div`` is its id."""
    html: str = drawn.to_html(
        include_plotlyjs=False,
        full_html=False,
        div_id=div,
        config={"displaylogo": False, "responsive": True},
    )
    return html


def over_time(drawn: go.Figure, div: str, runs: Iterable[Run]) -> str:
    """A figure whose axis is the time of the runs: all have the same, and zoom together."""
    end = max((float(run.cycle["t"][-1]) for run in runs if len(run.cycle["t"])), default=1.0)
    drawn.update_xaxes(range=[-0.01 * end, 1.01 * end])
    return f"<div class='time'>{figure(drawn, div)}</div>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], marks: Iterable[bool] = ()) -> str:
    """A table; its texts are escaped, a line feed in a heading breaks the line.

    Args:
        head: Headings.
        rows: Cells of each row.
        marks: Whether a row is marked, for each; empty: none is.
    """
    marked = iter(marks)
    lines = []
    for row in rows:
        mark = " class='fault'" if next(marked, False) else ""
        lines.append(f"<tr{mark}>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>")
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head).replace("\n", "<br>")
    return f"<div class='wide'><table><tr>{top}</tr>{''.join(lines)}</table></div>"


def timing_table(metrics: Mapping[str, Mapping[str, Any]]) -> str:
    """Percentiles of what a cycle took, µs, a row for each run and quantity.

    Args:
        metrics: By label of the run; that of a single one is not shown.
    """
    rows = []
    for label, found in metrics.items():
        for key, name in (("lateness_us", "lateness"), ("compute_us", "compute"),
                          ("exchange_us", "exchange")):  # fmt: skip
            values = found[key]
            if values["max"]:  # in lock-step nothing is late
                told = name if len(metrics) == 1 else f"{label}: {name}"
                rows.append([told, *(f"{values[p]:.1f}" for p in plots.PERCENTILES)])
    if not rows:
        return "<p>Nothing was measured.</p>"
    return table(["µs", *plots.PERCENTILES.values()], rows)


def bus_table(buses: Mapping[str, Sequence[BusTraffic]]) -> str:
    """Load of every bus, a row for each run and bus.

    Args:
        buses: By label of the run; that of a single one is not shown.
    """
    rows = []
    for label, found in buses.items():
        for bus in found:
            told = bus.name if len(buses) == 1 else f"{label}: {bus.name}"
            peak = f"{100 * bus.load.max():.1f}" if len(bus.load) else "–"
            shares = [bus.planned, bus.worst, bus.mean]
            numbers = [summary.cell(share, "%") for share in shares]
            rows.append([told, str(bus.joints), f"{bus.bitrate / 1e6:g}", *numbers, peak])
    if not rows:
        return "<p>The log does not say how the robot was wired.</p>"
    head = ["bus", "joints", "Mbit/s", "planned\n%", "worst case\n%", "mean\n%", "largest\n%"]
    return table(head, rows)


def bus_note(buses: Iterable[Sequence[BusTraffic]]) -> str:
    """What the columns of the bus table are."""
    told = "Planned: as <code>dftc bus budget</code> has it, without stuffing, and at worst."
    found = [bus for each in buses for bus in each]
    if any(len(bus.load) for bus in found):
        told += " Mean and largest (of 0.1 s): of the frames in the log, with their own stuffing."
    elif any(bus.mean is not None for bus in found):
        told += " Mean: as the rig counted, with set-up. Over time with --frames."
    else:
        told += " What was sent is not in this log: record it with --frames."
    return f"<p class='dim'>{told}</p>"


def events(run: Run) -> str:
    """The events of a run as a table."""
    if not run.events:
        return "<p>None.</p>"
    rows = [
        f"<tr><td>{event.t:.3f}</td><td>{_severity(event.severity)}</td>"
        f"<td>{escape(event.source)}</td><td>{escape(event.text)}</td></tr>"
        for event in run.events[:_EVENTS]
    ]
    rest = len(run.events) - _EVENTS
    more = f"<p>and {rest} more in the log</p>" if rest > 0 else ""
    return (
        "<div class='wide'><table class='events'><tr><th>t (s)</th><th>severity</th>"
        f"<th>source</th><th>text</th></tr>{''.join(rows)}</table></div>{more}"
    )


def scenario(run: Run, label: str = "Scenario") -> str:
    """The resolved scenario, to be unfolded; nothing where the log has none."""
    if not run.scenario:
        return ""
    shown = f"<summary>{escape(label)}</summary><pre>{escape(run.scenario)}</pre>"
    return f"<details>{shown}</details>"


def _severity(level: int) -> str:
    return plots.SEVERITIES[level] if level < len(plots.SEVERITIES) else str(level)
