"""The study of the law in discrete time as tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from dftc_rt.paper.discrete_cases import SCOPES, Scope, complete
from dftc_rt.paper.discrete_row import Row

_TITLES: Final = {
    "controller": "The controller alone: identifier and gain off",
    "whole": "The whole: identifier, observer and gain",
}


def table(rows: Sequence[Row]) -> str:
    """Return the tables of a study.

    A cell says what a run came to: ``4 ms: ĝ ≈ 0 of joint 2`` is when it diverged and which signal
    was first beyond its limit; a number in mrad is the larger tracking error of the two joints,
    RMS, before / after the start of the fault; ``chatters`` comes with the change of the torque
    from cycle to cycle, RMS, of the worse joint; ``ρ̂ 0.2`` is the error of joint 1's, RMS, under
    the fault.

    Args:
        rows: From :func:`dftc_rt.paper.discrete.study`, all or some.
    """
    parts: list[str] = []
    for scope in SCOPES:
        some = [row for row in rows if row.scope == scope]
        parts += _cumulative(some, scope)
    parts += _by_label([r for r in rows if r.group == "without"], "Left out, at 1 kHz", "without")
    parts += _by_label([r for r in rows if r.group == "factor"], "Values times ½ and 2", "value")
    parts += _others([r for r in rows if r.group == "other"])
    return "\n".join(parts)


def cell(row: Row) -> str:
    """Return what a run came to, in a few words."""
    if row.diverged_s is not None:
        return f"{_time(row.diverged_s)}: {row.first}"
    errors = [
        f"{1e3 * max(pair):.2g}" if max(pair) < 0.0995 else f"{1e3 * max(pair):.0f}"
        for pair in (row.before_rad, row.after_rad)
        if pair is not None
    ]
    text = " / ".join(errors) + " mrad"
    if row.scope == "whole" and row.rho_error is not None:
        text += f", ρ̂ {row.rho_error[0]:.2g}"
    if row.outcome == "chatters" and row.change_nm is not None:
        return f"chatters by {max(row.change_nm):.2g} Nm, {text}"
    return f"strays, {text}" if row.outcome == "strays" else text


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.2g} ms" if seconds < 0.0995 else f"{seconds:.3g} s"


def _markdown(head: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return [*lines, *("| " + " | ".join(line) + " |" for line in body), ""]


def _cumulative(rows: Sequence[Row], scope: Scope) -> list[str]:
    """One table per scope: what is on, against example and step."""
    found = {(r.example, r.step_s, len(r.on)): r for r in rows if r.group == "cumulative"}
    if not found:
        return []
    columns = sorted({key[:2] for key in found}, key=lambda key: (key[0], -key[1]))
    head = ["on", *(f"example {number}, {1e3 * step:g} ms" for number, step in columns)]
    names = ("as printed", *(f"+ {name}" for name in complete(scope)))
    body = []
    for count, name in enumerate(names):
        each = (found.get((*column, count)) for column in columns)
        body.append([name, *("" if row is None else cell(row) for row in each)])
    return [f"### {_TITLES[scope]}", "", *_markdown(head, body)]


def _by_label(rows: Sequence[Row], title: str, head: str) -> list[str]:
    """One line per label, one column per example and scope."""
    if not rows:
        return []
    columns = sorted({(r.example, r.scope) for r in rows}, key=lambda key: (key[1], key[0]))
    found = {(r.label, r.example, r.scope): r for r in rows}
    body = []
    for label in dict.fromkeys(r.label for r in rows):
        each = (found.get((label, *column)) for column in columns)
        body.append([label, *("" if row is None else cell(row) for row in each)])
    titles = [f"example {number}, {scope}" for number, scope in columns]
    return [f"### {title}", "", *_markdown([head, *titles], body)]


def _others(rows: Sequence[Row]) -> list[str]:
    """Other readings, one line each."""
    if not rows:
        return []
    columns = sorted({r.example for r in rows})
    found = {((r.scope, r.on, r.label), r.example): r for r in rows}
    body = []
    for key in dict.fromkeys((r.scope, r.on, r.label) for r in rows):
        scope, on, label = key
        named = "all" if on == complete(scope) else ", ".join(on) or "none"
        each = (found.get((key, number)) for number in columns)
        body.append([scope, named, label, *("" if r is None else cell(r) for r in each)])
    head = ["scope", "on", "besides", *(f"example {number}" for number in columns)]
    return ["### Other readings, at 1 kHz", "", *_markdown(head, body)]
