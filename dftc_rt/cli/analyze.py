"""``dftc analyze``: the metrics of a log."""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec
from rich.console import Console

from dftc_rt.analysis import metrics, summary
from dftc_rt.log.reader import read


def analyze(log: str | Path, *, twin: str | Path | None = None, json: bool = False) -> int:
    """Print the metrics of a log.

    Example::

        dftc analyze run.mcap --twin healthy.mcap --json

    Args:
        log: The log.
        twin: Log of the same scenario and seed with ``--set fault=[]``: what the fault
            costs is judged against it.
        json: Print one JSON object on stdout.

    Returns:
        Exit code.

    Raises:
        LogError: A log cannot be read.
        InputError: The twin differs from the log in more than its faults.
    """
    other = None if twin is None else read(twin)
    found = metrics.evaluate(read(log), twin=other, twin_name=f"--twin {twin}")
    if json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        summary.show(found, Console(file=sys.stdout))
    return 0
