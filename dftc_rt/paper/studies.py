"""Further studies that a summary may carry: other readings, other fits, the law in discrete time.

Each takes minutes. Their runs are tasks for the same workers as the figures' own.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from dftc_rt.paper import discrete, discrete_cases, fit_rows, search, search_space
from dftc_rt.pool import Task


@dataclass(frozen=True)
class Study:
    """A study.

    Attributes:
        key: Its key in the summary.
        title: Its heading.
        tasks: Its runs, in the order of its rows.
    """

    key: str
    title: str
    tasks: tuple[Task, ...]

    def rows(self, results: Mapping[str, Any]) -> list[Any]:
        """Pick its rows from the results of all tasks."""
        return [results[task.name] for task in self.tasks]

    def plain(self, results: Mapping[str, Any]) -> Any:
        """Return its rows as plain data."""
        return json.loads(_JSON[self.key](self.rows(results)))

    def markdown(self, results: Mapping[str, Any]) -> str:
        """Return its tables."""
        rows = self.rows(results)
        if self.key == "discrete":
            return discrete.table(rows)
        if self.key == "fit":
            return fit_rows.table(_joined(rows))
        sentences = [line for line in search.summary(rows) if " of 0 readings" not in line]
        return "\n".join([*(f"- {line}" for line in sentences), "", search.table(rows)])


def _joined(rows: Sequence[Any]) -> list[Any]:
    """The rows of every example in one list."""
    return [row for of_example in rows for row in of_example]


_JSON: Final[dict[str, Callable[[list[Any]], str]]] = {
    "search": search.to_json,
    "discrete": discrete.to_json,
    "fit": lambda rows: fit_rows.to_json(_joined(rows)),
}


def fitted(examples: Sequence[int]) -> Study:
    """Fit the networks of our observer in other forms and to other data."""
    tasks = (
        Task(f"fit {number}", fit_rows.compare, (number,), lane)
        for lane, number in enumerate(examples)
    )
    return Study("fit", "The fitted observer, by networks and data", tuple(tasks))


def searched(examples: Sequence[int]) -> Study:
    """Try other readings of the equations for Figs. 2, 4 and 7."""
    candidates = [each for each in search_space.space() if each.example in examples]
    tasks = (
        Task(f"search {k}: {each.name}", search.judge, (each,), examples.index(each.example))
        for k, each in enumerate(candidates)
    )
    return Study("search", "Other readings", tuple(tasks))


def discretised(examples: Sequence[int]) -> Study:
    """Run the law at fixed steps, as printed and with one regularisation after another."""
    tasks = (
        Task(f"discrete {k}", discrete_row, (case,), examples.index(case.example))
        for k, case in enumerate(discrete_cases.cases(examples))
    )
    return Study("discrete", "The law in discrete time", tuple(tasks))


def discrete_row(case: discrete_cases.Case) -> discrete.Row:
    """One run in discrete time, without its samples; in a worker."""
    return discrete.run(case)[0]
