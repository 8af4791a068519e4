"""What a benchmark hands back, and how it is printed: tables, and aims with their verdicts."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TextIO

SECONDS_VARIABLE = "DFTC_BENCHMARK_SECONDS"
Cell = str | int | float | None


@dataclass(frozen=True)
class Table:
    """One table of results.

    Attributes:
        title: What is measured, and its unit.
        header: Column names.
        rows: One cell a column; None is printed as a dash.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]


@dataclass(frozen=True)
class Aim:
    """One figure that the project wants to reach.

    Attributes:
        what: What is compared, with its floor.
        relation: ``<=`` or ``>=``.
        limit: The aim.
        reached: The figure of this run; None when it could not be measured.
    """

    what: str
    relation: str
    limit: float
    reached: float | None

    @property
    def met(self) -> bool | None:
        """Whether the aim was reached; None when it could not be measured."""
        if self.reached is None:
            return None
        return self.reached <= self.limit if self.relation == "<=" else self.reached >= self.limit

    def line(self) -> str:
        """Return the verdict as a line for people."""
        met = {True: "yes", False: "no", None: "not measured"}[self.met]
        return f"{self.what}: aim {self.relation} {_text(self.limit)}, " + (
            f"reached {_text(self.reached)}: {met}"
        )


@dataclass(frozen=True)
class Result:
    """One benchmark's results.

    Attributes:
        name: Of the benchmark.
        tables: What was measured.
        aims: What was wanted.
        notes: One line each: what the figures do not say.
    """

    name: str
    tables: Sequence[Table] = ()
    aims: Sequence[Aim] = ()
    notes: Sequence[str] = field(default_factory=tuple)


def seconds_of(default: float) -> float:
    """How long a benchmark lasts: what ``--seconds`` says, else its own time."""
    return float(os.environ.get(SECONDS_VARIABLE, default))


def show(result: Result, out: TextIO) -> None:
    """Print a result as plain text."""
    for table in result.tables:
        cells = [list(table.header), *([_text(cell) for cell in row] for row in table.rows)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(table.header))]
        out.write(f"\n{table.title}\n\n")
        for number, row in enumerate(cells):
            line = "  ".join(
                cell.ljust(width) if i == 0 else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(row, widths, strict=True))
            )
            out.write(f"  {line.rstrip()}\n")
            if number == 0:
                out.write("  " + "  ".join("-" * width for width in widths) + "\n")
    if result.aims:
        out.write("\n")
    for aim in result.aims:
        out.write(f"  {aim.line()}\n")
    for note in result.notes:
        out.write(f"  note: {note}\n")
    out.flush()


def plain(result: Result) -> dict[str, Any]:
    """Return a result ready for JSON."""
    return {
        "name": result.name,
        "tables": [
            {
                "title": table.title,
                "header": list(table.header),
                "rows": [list(row) for row in table.rows],
            }
            for table in result.tables
        ],
        "aims": [
            {
                "what": aim.what, "relation": aim.relation, "limit": aim.limit,
                "reached": aim.reached, "met": aim.met,
            }
            for aim in result.aims
        ],
        "notes": list(result.notes),
    }  # fmt: skip


def _text(cell: Cell) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, float):
        return f"{cell:.3g}" if abs(cell) < 10 else f"{cell:.1f}"
    return str(cell)
