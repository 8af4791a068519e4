"""Rows of the results that a table is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from dftc_rt.benchmark.rows import FaultRow, NegativeRow

Pair = tuple[FaultRow, FaultRow]


@dataclass(frozen=True)
class Rows:
    """All rows that a page is about, of one draw.

    Attributes:
        draw: ``tuning`` or ``sealed``.
        faults: Twins and cases.
        negative: Runs of the negative set.
    """

    draw: str
    faults: Sequence[FaultRow]
    negative: Sequence[NegativeRow]

    @classmethod
    def of(
        cls,
        draw: str,
        momentum_threshold: float,
        faults: Iterable[FaultRow],
        negative: Iterable[NegativeRow],
    ) -> Rows:
        """Those of a draw, with one threshold of the law ``momentum``; the last of each case."""

        def mine(row: FaultRow | NegativeRow) -> bool:
            other = abs(row.momentum_threshold - momentum_threshold) > 1e-6 * momentum_threshold
            return row.draw == draw and not (row.variant == "momentum" and other)

        last = {row.id: row for row in faults if mine(row)}
        last_negative = {row.id: row for row in negative if mine(row)}
        return cls(draw, list(last.values()), list(last_negative.values()))

    def of_law(self, variant: str = "dftc", interconnection: str = "desired") -> list[FaultRow]:
        """Twins and cases of a law, also those beyond its authority."""
        return [
            row
            for row in self.faults
            if row.variant == variant and row.interconnection == interconnection
        ]

    def cases(
        self,
        variant: str = "dftc",
        interconnection: str = "desired",
        kind: str | None = None,
        where: Callable[[FaultRow], bool] = lambda row: True,
    ) -> list[FaultRow]:
        """Cases of a law on loaded joints, within their authority."""
        return [
            row
            for row in self.of_law(variant, interconnection)
            if row.kind != "twin"
            and (kind is None or row.kind == kind)
            and not row.beyond
            and where(row)
        ]

    def healthy(self, variant: str = "dftc", interconnection: str = "desired") -> list[NegativeRow]:
        """Runs of the negative set of a law."""
        return [
            row
            for row in self.negative
            if row.variant == variant and row.interconnection == interconnection
        ]

    def laws(self) -> list[tuple[str, str]]:
        """Law and interconnection of every row, in the order in which they came up."""
        every = [(row.variant, row.interconnection) for row in (*self.faults, *self.negative)]
        return list(dict.fromkeys(every))


def key(row: FaultRow) -> tuple[str, int, str, str]:
    """What makes two rows of different laws the same case."""
    return row.robot, row.seed, row.kind, row.joint


def pairs(ours: Iterable[FaultRow], theirs: Iterable[FaultRow]) -> list[Pair]:
    """Rows of the same case under two laws."""
    other = {key(row): row for row in theirs}
    return [(row, other[key(row)]) for row in ours if key(row) in other]
