"""One self-contained HTML file that shows a run: it needs neither network nor Python."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any, Final

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from dftc_rt.analysis import plots, summary
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
"""
"""Zooms the time axes of all figures together."""

_STYLE: Final = """
:root { color-scheme: light dark; --line: #d5d9e0; --mark: #fff3d6; }
@media (prefers-color-scheme: dark) { :root { --line: #3a3f47; --mark: #4a3d1c; } }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.4rem; } h2 { font-size: 1.1rem; margin-top: 2rem; }
.verdict { font-size: 1.1rem; font-weight: 600; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .6rem; border-bottom: 1px solid var(--line); text-align: right; }
th:first-child, td:first-child, .events td { text-align: left; }
tr.fault { background: var(--mark); }
.dim { opacity: .7; }
@media print { body { max-width: none; } .time, tr { break-inside: avoid; } }
pre { overflow-x: auto; }
"""


def write_report(run: Run, metrics: Mapping[str, Any], path: str | Path) -> None:
    """Write the report of a run.

    Args:
        run: The run; its curves are thinned to keep every peak.
        metrics: As :func:`dftc_rt.analysis.metrics.evaluate` returns them.
        path: HTML file to write.

    Raises:
        LogError: The file cannot be written.
    """
    name = str(metrics["robot"] or "robot")
    control = "fault-tolerant" if metrics["ftc"] else "without fault tolerance"
    told = f"{metrics['law']}, {control}, {metrics['duration_s']:.1f} s"
    parts = [
        f"<h1>{escape(name)}</h1><p class='dim'>{escape(told)}</p>",
        f"<p class='verdict'>{escape(summary.verdict(metrics))}</p>",
        _table(metrics),
        f"<p class='dim'>{escape(summary.timing_line(metrics))}</p>",
    ]
    for i, joint in enumerate(run.joints):
        parts.append(f"<h2>{escape(joint)}</h2>")
        parts.append(_time(plots.joint_figure(run, joint, metrics["faults"]), f"joint{i}"))
    parts += ["<h2>Timing</h2>", _figure(plots.timing_figure(run), "timing")]
    parts.append("<h2>Events</h2>")
    if run.events:
        parts.append(_time(plots.event_figure(run), "events"))
    parts += [_events(run), f"<script>{_JOIN}</script>"]
    if run.scenario:
        parts.append(
            f"<details><summary>Scenario</summary><pre>{escape(run.scenario)}</pre></details>"
        )
    try:
        Path(path).write_text(_page(name, parts), encoding="utf-8")
    except OSError as error:
        raise LogError(str(path), f"cannot be written: {error.strerror}") from None


def _page(title: str, parts: Iterable[str]) -> str:
    body = "\n".join(parts)
    return (
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width'>"
        f"<title>{escape(title)}</title><style>{_STYLE}</style>"
        f"<script>{get_plotlyjs()}</script></head>\n<body>\n{body}\n</body></html>\n"
    )


def _figure(figure: go.Figure, div: str) -> str:
    html: str = figure.to_html(
        include_plotlyjs=False,
        full_html=False,
        div_id=div,
        config={"displaylogo": False, "responsive": True},
    )
    return html


def _time(figure: go.Figure, div: str) -> str:
    """A figure whose axis is the time of the run."""
    return f"<div class='time'>{_figure(figure, div)}</div>"


def _table(metrics: Mapping[str, Any]) -> str:
    columns = summary.shown_columns(metrics)
    faulted = {fault["joint"] for fault in metrics["faults"]}
    head = "".join(f"<th>{escape(title)}</th>" for title, _, _ in columns).replace("\n", "<br>")
    rows = []
    for name, joint in metrics["joints"].items():
        cells = "".join(f"<td>{summary.cell(joint[key], form)}</td>" for _, key, form in columns)
        mark = " class='fault'" if name in faulted else ""
        rows.append(f"<tr{mark}><td>{escape(name)}</td>{cells}</tr>")
    return f"<div class='wide'><table><tr><th>joint</th>{head}</tr>{''.join(rows)}</table></div>"


def _events(run: Run) -> str:
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


def _severity(level: int) -> str:
    return plots.SEVERITIES[level] if level < len(plots.SEVERITIES) else str(level)
