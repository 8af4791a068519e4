"""Progress of a long command: a bar on a terminal, else a line now and then."""

from __future__ import annotations

import sys
import time
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

_PLAIN_S: Final = 20.0  # between two lines where stderr is no terminal


class Progress:
    """Counts tasks; a context manager that ends the bar."""

    def __init__(self, what: str, total: int) -> None:
        """Start counting.

        Args:
            what: What is done, for people.
            total: Number of tasks.
        """
        self._what = what
        self._total = total
        self._done = 0
        self._rows = 0
        self._started = time.monotonic()
        self._next = self._started + _PLAIN_S
        self._bar: Bar | None = None
        if sys.stderr.isatty():
            self._bar = Bar(
                TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
                TimeElapsedColumn(), console=Console(stderr=True), transient=True,
            )  # fmt: skip
            self._task = self._bar.add_task(what, total=total)

    def __enter__(self) -> Progress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def done(self) -> None:
        """A task has come to its end."""
        self._done += 1
        self._show()

    def row(self) -> None:
        """A row has been written."""
        self._rows += 1
        self._show()

    def _show(self) -> None:
        text = f"{self._what}, {self._rows} rows" if self._rows else self._what
        if self._bar is not None:
            self._bar.update(self._task, description=text, completed=self._done)
        elif time.monotonic() >= self._next:
            self._next = time.monotonic() + _PLAIN_S
            spent = time.monotonic() - self._started
            line = f"dftc: {text}: {self._done} of {self._total} groups, {spent:.0f} s"
            print(line, file=sys.stderr, flush=True)
