"""The results file: rows are appended as they come, and a run that is repeated goes on.

Rows of other sources or another calibration are not mixed in: they are moved to a file beside.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Final, TypeVar

from dftc_rt.benchmark.rows import (
    FAULT_COLUMNS,
    NEGATIVE_COLUMNS,
    SWEEP_COLUMNS,
    FaultRow,
    NegativeRow,
    Row,
    SweepRow,
    cells,
    fault_row,
    negative_row,
    sweep_row,
)
from dftc_rt.errors import InputError

AnyRow = TypeVar("AnyRow", bound=Row)

RESULTS: Final = "results.csv"
NEGATIVE: Final = "negative.csv"
SWEEP: Final = "sweep.csv"


def load_faults(path: Path) -> list[FaultRow]:
    """All rows of a results file; none if it is not there.

    A file of a version with other columns is moved aside.

    Raises:
        InputError: It is no such file.
    """
    return _load(path, FAULT_COLUMNS, fault_row)


def load_negative(path: Path) -> list[NegativeRow]:
    """All rows of a file of the negative set; none if it is not there.

    Raises:
        InputError: It is no such file.
    """
    return _load(path, NEGATIVE_COLUMNS, negative_row)


def load_sweep(path: Path) -> list[SweepRow]:
    """All rows of a sweep over thresholds; none if it is not there.

    Raises:
        InputError: It is no such file.
    """
    return _load(path, SWEEP_COLUMNS, sweep_row)


def _load(
    path: Path, columns: Mapping[str, str], make: Callable[[Mapping[str, str]], AnyRow]
) -> list[AnyRow]:
    if not path.exists():
        return []
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        what = f"cannot be read: {error}"
        raise InputError(str(path), what, "results of dftc benchmark") from None
    whole = text[: text.rfind("\n") + 1]  # the last line may be torn
    reader = csv.DictReader(io.StringIO(whole))
    names = reader.fieldnames or ()
    if whole and not {"id", "fingerprint"} <= set(names):
        raise InputError(str(path), "other columns", "results of dftc benchmark")
    if whole and set(names) != set(columns):  # made by another version
        os.replace(path, _free(path.with_name(f"{path.stem}.old{path.suffix}")))
        return []
    rows = []
    for cell in reader:
        try:
            rows.append(make(cell))
        except (ValueError, TypeError) as error:
            where = f"{path}:{reader.line_num}"
            raise InputError(where, str(error), "a row of dftc benchmark") from None
    return rows


def _free(path: Path) -> Path:
    """The path, or one with a number that is not there yet."""
    found, number = path, 1
    while found.exists():
        number += 1
        found = path.with_name(f"{path.stem}{number}{path.suffix}")
    return found


class Store:
    """A results file that is open for more rows."""

    def __init__(self, path: Path, columns: Sequence[str], kept: Sequence[Row]) -> None:
        """Write the rows that are kept, and stay open.

        Args:
            path: The file; what else is in it is dropped.
            columns: Names of the columns.
            kept: Rows to begin with.

        Raises:
            InputError: The file cannot be written.
        """
        self._columns = list(columns)
        fresh = path.with_name(path.name + ".new")
        try:
            with fresh.open("w", encoding="utf-8", newline="") as stream:
                writer = self._writer(stream)
                writer.writeheader()
                writer.writerows(cells(row) for row in kept)
            os.replace(fresh, path)
            self._stream = path.open("a", encoding="utf-8", newline="")
        except OSError as error:
            raise InputError(str(path), f"cannot be written: {error.strerror}") from None
        self._append = self._writer(self._stream)

    def append(self, row: Row) -> None:
        """Write a row; it is in the file when this returns."""
        self._append.writerow(cells(row))
        self._stream.flush()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _writer(self, stream: IO[str]) -> csv.DictWriter[str]:
        return csv.DictWriter(stream, self._columns, lineterminator="\n")


def set_aside(path: Path, columns: Sequence[str], rows: Sequence[Row]) -> list[Path]:
    """Append rows of other fingerprints to files named for them; return the files."""
    files = []
    for each in sorted({row.fingerprint for row in rows}):
        beside = path.with_name(f"{path.stem}.{each}{path.suffix}")
        new = not beside.exists()
        with beside.open("a", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(stream, list(columns), lineterminator="\n")
            if new:
                writer.writeheader()
            writer.writerows(cells(row) for row in rows if row.fingerprint == each)
        files.append(beside)
    return files
