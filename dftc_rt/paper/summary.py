"""The summary: what each figure claims, what was measured, and what follows; JSON and Markdown."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import msgspec

from dftc_rt.errors import InputError
from dftc_rt.paper.figures import gain_words, name
from dftc_rt.paper.runs import Drawn
from dftc_rt.paper.verdicts import Finding, Target

_PACKAGES: Final = ("dftc_rt", "matplotlib", "numba", "numpy", "scipy")

PREMISE: Final = (
    "Every run integrates (1)-(33) with the paper's parameters as one stiff differential equation, "
    "sgn as tanh(s/ε) and ĝ of the controller at least 0.001, because (10) divides by it; "
    "Γ_δo = 500, which the paper does not state, is ours. “As written” is short for that."
)
RULE: Final = (
    "A figure *reproduces* if the equations as written meet its rule, and *reproduces under a "
    "condition* if they meet it in a variant that takes something more. What is ours counts for "
    "no verdict."
)


def collect(
    findings: Sequence[Finding],
    targets: Sequence[Target],
    drawn: Drawn,
    runs_failed: Mapping[str, str],
    studies: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the summary as plain data, as ``--json`` prints it.

    Args:
        findings: One for each figure.
        targets: What our observer is to reach.
        drawn: What the figures show.
        runs_failed: Runs that the solver gave up, and what it said.
        studies: Rows of further studies, by name.
    """
    return {
        "figures": [
            asdict(finding) | {"verdict": finding.verdict, "conditions": list(finding.conditions)}
            for finding in findings
        ],
        "targets": [asdict(target) | {"met": target.met} for target in targets],
        "drawn": asdict(drawn) | {"default": drawn.usual, "shown": drawn_words(drawn)},
        "premise": PREMISE,
        "failed": dict(runs_failed),
        "versions": versions(),
        **studies,
    }


def versions() -> dict[str, str]:
    """Return package -> version of what the numbers depend on."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed as a package"
    return found


def drawn_words(drawn: Drawn) -> str:
    """What the figures show, in one sentence."""
    robust = {"on": "go on adapting", "held": "are held", "removed": "are removed"}[drawn.robust]
    identifier = "goes on adapting" if drawn.identifier == "adapt" else "is frozen"
    return (
        f"ε = {drawn.epsilon:g}; from the fault on δ̂, ξ̂ {robust} and the identifier {identifier}; "
        f"gain of Figs. 5 and 10: {gain_words(drawn.gain)}"
    )


def markdown(summary: Mapping[str, Any], studies: Mapping[str, str]) -> str:
    """Return the summary as a Markdown page that shows the figures beside it.

    Args:
        summary: From :func:`collect`.
        studies: Heading -> tables of further studies.
    """
    lines = [
        "| figure | claim | measured here | verdict |",
        "|---|---|---|---|",
        *(_line(figure) for figure in summary["figures"]),
        "",
        RULE,
        "",
        PREMISE,
        "",
        f"The figures show: {summary['drawn']['shown']}."
        + ("" if summary["drawn"]["default"] else " This is not the default."),
        "",
        "RMSE of our ρ̂_1, from 1 s (Example 1) and 0.5 s (Example 2) after the fault on:",
        "",
        "| example | observer | RMSE | to reach | |",
        "|---|---|---|---|---|",
        *(
            f"| {t['example']} | {t['title']} | {number(t['number'])} | ≤ {t['limit']:g} "
            f"| {'reached' if t['met'] else 'missed'} |"
            for t in summary["targets"]
        ),
    ]
    for figure in summary["figures"]:
        lines += ["", *_section(figure)]
    if summary["failed"]:
        lines += ["", "## Runs that the solver gave up", ""]
        lines += [f"- {run}: {said}" for run, said in summary["failed"].items()]
    for heading, tables in studies.items():
        lines += ["", f"## {heading}", "", tables.rstrip()]
    told = ", ".join(f"{package} {version}" for package, version in summary["versions"].items())
    return "\n".join([*lines, "", f"Versions: {told}.", ""])


def _line(figure: Mapping[str, Any]) -> str:
    verdict = f"**{figure['verdict']}**"
    if figure["conditions"]:
        verdict += ": " + "; or ".join(figure["conditions"])
    return (
        f"| [{figure['figure']}](#fig-{figure['figure']}) | {figure['claim']} "
        f"| {_cell(measured(figure))}; to meet: {_cell(figure['rule'])} | {verdict} |"
    )


def measured(figure: Mapping[str, Any]) -> str:
    """What was measured of the figure as claimed: quantity, number and unit."""
    value = number(figure["rows"][0]["number"])
    return f"{figure['quantity']}: {value} {figure['unit']}".rstrip()


def _section(figure: Mapping[str, Any]) -> list[str]:
    rows = figure["rows"]
    names = list(dict.fromkeys(key for row in rows for key in row["detail"]))
    unit = f"/({figure['unit']})" if "/" in figure["unit"] else f"/{figure['unit']}"
    head = "number" + (unit if figure["unit"] else "")
    lines = [
        f"## Fig. {figure['figure']}",
        "",
        f"Example {figure['example']}. {figure['title']}. Claim: {figure['claim']}. "
        f"Number: {figure['quantity']}. Met: {figure['rule']}.",
        "",
        f"![Fig. {figure['figure']}: {figure['title']}]({name(figure['figure'])}.png)",
        "",
        "| variant | " + " | ".join([_cell(head), *map(_cell, names), "met"]) + " |",
        "|---|" + "---|" * (len(names) + 2),
    ]
    for row in rows:
        cells = [number(row["number"]), *(number(row["detail"].get(each)) for each in names)]
        met = "yes" if row["met"] else "no"
        lines.append(f"| {_cell(row['title'])} | " + " | ".join([*cells, met]) + " |")
    if figure["remark"]:
        lines += ["", figure["remark"]]
    return lines


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def number(value: float | None) -> str:
    """Three significant digits; a dash for what was not measured."""
    if value is None:
        return "–"
    if value and abs(value) < 1e-4:
        return f"{value:.0e}".replace("e-0", "e-")
    return f"{value:.4g}" if abs(value) >= 1000 else f"{value:.3g}"


def write(summary: Mapping[str, Any], studies: Mapping[str, str], folder: Path) -> list[Path]:
    """Write ``summary.json`` and ``summary.md``; return the files.

    Args:
        summary: From :func:`collect`.
        studies: Heading -> tables of further studies.
        folder: Where the files go; it is there.

    Raises:
        InputError: A file cannot be written.
    """
    encoded = msgspec.json.format(msgspec.json.encode(summary), indent=1).decode() + "\n"
    page = "# What reproduces\n\n" + markdown(summary, studies)
    files = []
    for path, text in ((folder / "summary.json", encoded), (folder / "summary.md", page)):
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise InputError(str(path), f"cannot be written: {error.strerror}") from None
        files.append(path)
    return files
