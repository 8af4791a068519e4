"""What a log says: metrics, timing, figures, report; and :func:`load`, its arrays in one line."""

from __future__ import annotations

from pathlib import Path

from dftc_rt.log.reader import read
from dftc_rt.log.run import Run


def load(path: str | Path) -> Run:
    """Load a log, frames included where they were recorded.

    ``load("run.mcap").cycle["q"]`` is the measured position, (K, n); ``.columns()`` has a field
    a joint, ``.frame()`` the same as a pandas ``DataFrame``.

    Raises:
        LogError: Missing, foreign, torn (says how to repair it) or damaged.
    """
    return read(path, frames=True)
