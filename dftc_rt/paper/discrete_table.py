"""The study of the law in discrete time as tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from dftc_rt.paper.discrete_cases import SCOPES, STEPS_S, Scope, complete
from dftc_rt.paper.discrete_row import Row

_HEAD: Final = (
    "Each cell is one run. *4 ms: ĝ ≈ 0 of joint 2*: it diverged then, and that signal was the "
    "first beyond its limit. *5.1 / 4.6 mrad*: the larger tracking error of the two joints, RMS, "
    "before / under the fault. *chatters by 9 Nm*: the torque changes by that much from cycle to "
    "cycle, RMS, more than 1 % of its limit. *strays*: more than 100 mrad. *ρ̂ 0.24*: error of "
    "joint 1's, RMS, under the fault; 0.24 in example 1 and 0.20 in example 2 is what ρ̂ = 1 has. "
    "Runs at 1 ms last 200 s, at smaller steps as long as the paper's."
)
_TITLES: Final = {
    "controller": "The controller alone: identifier and gain off",
    "whole": "The whole: identifier, observer and gain",
}


def table(rows: Sequence[Row]) -> str:
    """Return the tables of a study, after a paragraph that says how to read them.

    Args:
        rows: From :func:`dftc_rt.paper.discrete.study`, all or some.
    """
    parts = [_HEAD, ""]
    for scope in SCOPES:
        some = [row for row in rows if row.scope == scope]
        parts += _cumulative(some, scope)
    parts += _values([r for r in rows if r.group == "cumulative" and r.step_s == STEPS_S[0]])
    parts += _by_label([r for r in rows if r.group == "without"], "Left out, at 1 kHz", "without")
    parts += _by_label([r for r in rows if r.group == "factor"], "Values times ½ and 2", "value")
    parts += _others([r for r in rows if r.group == "other"])
    return "\n".join(parts)


def cell(row: Row) -> str:
    """Return what a run came to, in a few words."""
    if row.diverged_s is not None:
        return f"{_time(row.diverged_s)}: {row.first}"
    errors = [_short(1e3 * max(p)) for p in (row.before_rad, row.after_rad) if p is not None]
    text = " / ".join(errors) + " mrad"
    if row.scope == "whole" and row.rho_error is not None:
        text += f", ρ̂ {row.rho_error[0]:.2g}"
    if row.outcome == "chatters" and row.change_nm is not None:
        return f"chatters by {_short(max(row.change_nm))} Nm, {text}"
    return f"strays, {text}" if row.outcome == "strays" else text


def needed(rows: Sequence[Row], label: str) -> bool:
    """Whether a run fails without what ``label`` names, in any example or scope.

    Args:
        rows: From :func:`dftc_rt.paper.discrete.study`.
        label: One name, or several with ``", "`` between them.
    """
    without = [r for r in rows if r.group == "without" and r.label == label]
    return any(r.outcome != "runs" for r in without)


def _short(value: float) -> str:
    """Two digits, without an exponent."""
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


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
        if head == "without":
            body[-1].append("yes" if needed(rows, label) else "no")
    titles = [f"example {number}, {scope}" for number, scope in columns]
    if head == "without":
        titles.append("needed")
    return [f"### {title}", "", *_markdown([head, *titles], body)]


_SHOWN: Final = {
    "layer": "layer ε, rad/s", "g_min": "projection, least ĝ, 1/(kg m²)",
    "g_max": "projection, largest ĝ, 1/(kg m²)", "dead_zone": "dead zone w, rad/s",
    "leak_delta": "leakage σ, 1/s", "torque_limit": "saturation, Nm", "rho_min": "least ρ̂",
    "gamma_rho": "Γ_ρ", "gamma_go": "Γ_go",
}  # fmt: skip


def _values(rows: Sequence[Row]) -> list[str]:
    """Values at 1 ms, of both joints."""
    full = {r.example: r for r in rows if r.on == complete(r.scope)}  # the whole comes last
    if not full:
        return []
    body = []
    for key, title in _SHOWN.items():
        each = [full[number].settings.get(key) for number in sorted(full)]
        body.append(
            [title, *("" if v is None else f"{_short(v[0])}, {_short(v[1])}" for v in each)]
        )
    head = ["value, joint 1, joint 2", *(f"example {number}" for number in sorted(full))]
    return ["### Values at 1 ms", "", *_markdown(head, body)]


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
