"""The benchmarks run and print tables with verdicts; what they measure is not asserted."""

from __future__ import annotations

import io
import json

import pytest

from tests.benchmarks import __main__ as command
from tests.benchmarks.result import Aim, Result, Table, plain, show


@pytest.mark.benchmark
@pytest.mark.parametrize("name", command.NAMES)
def test_quick_run_gives_tables(name: str) -> None:
    result = command.run(name, quick=True)
    assert result.tables
    for table in result.tables:
        assert table.rows
        assert {len(row) for row in table.rows} == {len(table.header)}
    json.dumps(plain(result))


@pytest.mark.parametrize(
    ("relation", "reached", "word"),
    [("<=", 1.5, "yes"), ("<=", 1.6, "no"), (">=", 1.5, "yes"), (">=", 1.4, "no"),
     ("<=", None, "not measured")],
)  # fmt: skip
def test_verdict(relation: str, reached: float | None, word: str) -> None:
    line = Aim("this over that", relation, 1.5, reached).line()
    assert line.startswith(f"this over that: aim {relation} 1.5, reached ")
    assert line.endswith(f": {word}")


def test_table_is_printed_in_columns() -> None:
    out = io.StringIO()
    table = Table("Things, us", ("thing", "median"), [("one", 12.34), ("another", None)])
    show(Result("things", [table], notes=["of no use"]), out)
    assert out.getvalue().splitlines() == [
        "",
        "Things, us",
        "",
        "  thing    median",
        "  -------  ------",
        "  one        12.3",
        "  another       -",
        "  note: of no use",
    ]
