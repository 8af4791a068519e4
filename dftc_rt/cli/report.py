"""``dftc report``: a log as one HTML file."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dftc_rt.analysis import metrics
from dftc_rt.analysis.report import write_report
from dftc_rt.cli.output import check_output
from dftc_rt.errors import LogError
from dftc_rt.log.reader import read


def report(log: str | Path, *, output: Annotated[str | Path, Parameter(alias="-o")]) -> int:
    """Write a report of a log: one HTML file that needs no network.

    Example::

        dftc report run.mcap -o run.html

    Args:
        log: The log.
        output: The HTML file to write.

    Returns:
        Exit code.

    Raises:
        LogError: The log cannot be read.
        InputError: The report cannot be written.
    """
    if os.path.exists(log) and os.path.exists(output) and os.path.samefile(log, output):
        raise LogError(str(output), "the log itself", "another file to write to")
    check_output(output)
    run = read(log)
    write_report(run, metrics.evaluate(run), output)
    sys.stdout.write(f"{output}\n")
    return 0
