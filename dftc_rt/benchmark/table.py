"""A table of the page: Markdown from cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dftc_rt.benchmark import statistics
from dftc_rt.benchmark.cases import VARIANTS

Cells = tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        title: Above it.
        header: Names of the columns.
        rows: Cells.
        note: Below it.
    """

    title: str
    header: Cells
    rows: Sequence[Cells]
    note: str = ""

    def markdown(self) -> str:
        """As Markdown; a line says so if it has no rows."""
        if not self.rows:
            body = "None."
        else:
            lines = [self.header, tuple("---" for _ in self.header), *self.rows]
            body = "\n".join(
                f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |"
                for line in lines
            )
        return "\n\n".join(part for part in (f"## {self.title}", body, self.note) if part)


def law_title(variant: str, interconnection: str) -> str:
    """A law for people; of ``dftc`` with its interconnection."""
    title = VARIANTS[variant].title
    return title if interconnection == "desired" else f"{title}, `{interconnection}`"


def number(value: float | None, digits: int) -> str:
    """A number with so many decimals; a dash for none, *never* for an infinite one."""
    if value is None or math.isnan(value):
        return "–"
    return "never" if math.isinf(value) else f"{value:.{digits}f}"


def delay_cells(found: statistics.Delays) -> Cells:
    """Median, 95th percentile, largest, and how often never."""
    return (
        number(found.median, 3), number(found.most, 3), number(found.largest, 3), f"{found.never}",
    )  # fmt: skip
