"""What a row of the results depends on: sources, shipped data and calibration, as a hash."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

_DIGITS: Final = 12

CALIBRATION: Final = (
    "dftc_rt/*.py", "dftc_rt/bus/**/*.py", "dftc_rt/calibration/*.py", "dftc_rt/config/*.py",
    "dftc_rt/control/**/*.py", "dftc_rt/drives/**/*.py", "dftc_rt/dynamics/**/*.py",
    "dftc_rt/rt/*.py", "dftc_rt/cli/calibrate.py", "dftc_rt/cli/simulate.py",
    "dftc_rt/benchmark/conditions.py", "hil/**/*.py", "hil/scenarios/*.toml",
    "robots/*/robot.toml", "dftc_rt/_robots/*/robot.toml",
)  # fmt: skip
"""Files that decide what a calibration is, below the root of the installation."""
ROWS: Final = (
    *CALIBRATION, "dftc_rt/analysis/faults.py", "dftc_rt/analysis/metrics.py",
    *(f"dftc_rt/benchmark/{name}.py"
      for name in ("cases", "information", "measure", "negative", "rows", "sweep")),
    "dftc_rt/cli/benchmark_runs.py", "dftc_rt/cli/benchmark_sweep.py",
)  # fmt: skip
"""Files that decide what a row is; how rows are shown is not among them."""


def digest(files: Iterable[tuple[str, bytes]]) -> str:
    """Hash of names and contents, in the order of the names."""
    total = hashlib.sha256()
    for name, content in sorted(files):
        for part in (name.encode(), content):
            total.update(len(part).to_bytes(8, "big"))
            total.update(part)
    return total.hexdigest()[:_DIGITS]


def read_all(root: Path, patterns: Sequence[str]) -> list[tuple[str, bytes]]:
    """Names, relative to the root, and contents of all files that match."""
    found = {path for pattern in patterns for path in root.glob(pattern)}
    return [(path.relative_to(root).as_posix(), path.read_bytes()) for path in sorted(found)]
