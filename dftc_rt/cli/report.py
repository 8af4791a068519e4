"""``dftc report``: a log, or several side by side, as one HTML file or as a figure."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

from dftc_rt.analysis import figures, metrics
from dftc_rt.analysis.comparison import check_same_robot, write_comparison
from dftc_rt.analysis.report import write_report
from dftc_rt.cli.output import check_output
from dftc_rt.errors import InputError, LogError
from dftc_rt.log.reader import read
from dftc_rt.log.run import Run

_FORMATS: Final = ("html", "pdf", "png", "svg")


def report(
    *logs: Path,
    output: Annotated[Path, Parameter(alias="-o")],
    format: str | None = None,
    joint: str | None = None,
    span: tuple[float, float] | None = None,
) -> int:
    """Write a report of a log: one HTML file that needs no network; or a figure for a paper.

    Of up to four logs of a robot, the report has the numbers and curves side by side; what
    is compared is compared with the first. A figure, ``pdf``, ``png`` or ``svg``, shows one joint:
    tracking error, effectiveness, torque and residual.

    Example::

        dftc report run.mcap -o run.html
        dftc report with.mcap without.mcap -o both.html
        dftc report with.mcap without.mcap -o elbow.pdf --joint elbow_joint --span 4 12

    Args:
        logs: The log; several are compared.
        output: The file to write.
        format: html, pdf, png or svg; default: by the file's ending.
        joint: Joint of a figure; default: that of the first fault, else of the largest error.
        span: Start and end of a figure, s; default: the whole run.

    Returns:
        Exit code.

    Raises:
        LogError: A log cannot be read.
        InputError: The logs are of different robots, the format is not known or not that of
            the file's ending, or the report cannot be written.
        EnvironmentLacksError: A figure is asked for, and matplotlib is not installed.
    """
    form = _format(output, format)
    if form == "html" and (joint is not None or span is not None):
        option = "--joint" if joint is not None else "--span"
        raise InputError(option, "a report in HTML shows all of the run", "--format pdf, png, svg")
    if not logs:
        raise InputError("dftc report", "no log", "the log of a run, or several to compare")
    for log in logs:
        if os.path.exists(log) and os.path.exists(output) and os.path.samefile(log, output):
            raise LogError(str(output), "the log itself", "another file to write to")
    check_output(output)
    runs = {str(log): read(log, frames=form == "html") for log in logs}
    if len(logs) > 1:
        if len(runs) < len(logs):
            raise InputError("logs to compare", "the same log twice", "different ones")
        check_same_robot(runs)
    runs = dict(zip(_labels(logs), runs.values(), strict=True))
    if form == "html":
        _html(runs, output)
    else:
        chosen = figures.joint_to_show(runs) if joint is None else joint
        figures.save(figures.joint_figure(runs, chosen, span), output)
    sys.stdout.write(f"{output}\n")
    return 0


def _html(runs: dict[str, Run], output: Path) -> None:
    found = {label: metrics.evaluate(run) for label, run in runs.items()}
    if len(runs) == 1:
        ((label, run),) = runs.items()
        write_report(run, found[label], output)
    else:
        write_comparison(runs, found, output)


def _labels(logs: Sequence[Path]) -> list[str]:
    """Return what to call the logs: the names of their files, whole paths where those are equal."""
    stems = [log.stem for log in logs]
    return stems if len(set(stems)) == len(stems) else [str(log) for log in logs]


def _format(output: Path, form: str | None) -> str:
    """Return the format to write.

    Raises:
        InputError: It is not known, or the file's ending is that of another.
    """
    ending = output.suffix.lower().removeprefix(".")
    if form is not None and form not in _FORMATS:
        raise InputError("--format", f"'{form}'", ", ".join(_FORMATS))
    if ending not in _FORMATS:
        endings = f".{form}" if form is not None else ", ".join(f".{each}" for each in _FORMATS)
        raise InputError(str(output), f"an ending '{output.suffix}' of no format", endings)
    if form is not None and form != ending:
        raise InputError(str(output), f"an ending '{output.suffix}'", f"'.{form}' of {form}")
    return ending
