"""``dftc paper``: the ten figures of the paper, and what of them reproduces."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np
from cyclopts import Parameter
from rich.cells import set_cell_size
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from dftc_rt.analysis.faults import rho_at, running_mask
from dftc_rt.analysis.metrics import tracking_error
from dftc_rt.cli import session
from dftc_rt.cli.output import check_output
from dftc_rt.cli.simulate import run_simulation, warm_up
from dftc_rt.errors import EnvironmentLacksError, InputError
from dftc_rt.paper import figures, runs, series, studies, summary
from dftc_rt.paper.claims import Judge
from dftc_rt.paper.examples import EXAMPLES
from dftc_rt.paper.measures import largest, rms
from dftc_rt.paper.verdicts import CONDITIONAL, REPRODUCES, Sampled
from dftc_rt.pool import Task

SCENARIOS: Final = {1: "paper_example1", 2: "paper_example2"}
"""Shipped scenarios that run the examples through the product's own path, by example."""
_CLAIM, _VALUE = 37, 13  # widths of columns
_PLAIN_S: Final = 10.0  # between two lines of progress where stderr is no terminal


def paper(
    *,
    output: Annotated[str | Path, Parameter(alias="-o")],
    example: int | None = None,
    epsilon: float = 0.01,
    gain: str = "desired",
    robust: Literal["on", "held", "removed"] = "on",
    identifier: Literal["adapt", "frozen"] = "frozen",
    discrete: bool = False,
    search: bool = False,
    fit: bool = False,
    json: bool = False,
) -> int:
    """Draw the paper's figures and say what of them reproduces.

    Writes Figures 1-10 (PNG, SVG), their series (CSV), summary.md and summary.json. The
    summary has rows for all variants, whatever is drawn.

    Example::

        dftc paper -o paper_figures

    Args:
        output: Folder to write to; made if it is not there.
        example: 1 (Figs. 1-5) or 2 (Figs. 6-10); both without.
        epsilon: Width of tanh(s/epsilon) that stands for sgn, rad/s.
        gain: What drives the gain of Figs. 5 and 10: desired, frozen, fitted, measured,
            true_rho, true or none.
        robust: What becomes of the adaptive bounds under the fault.
        identifier: What becomes of the identifier under the fault.
        discrete: Also run the law at fixed steps, as printed and with what it needs; takes
            minutes more.
        search: Also look for a reading of the paper that gives Figs. 2, 4 and 7; takes minutes
            more.
        fit: Also fit the networks of our observer in other forms and to other data.
        json: Print the summary as one JSON object on stdout.

    Returns:
        Exit code.

    Raises:
        InputError: An option is wrong, or the folder cannot be written.
        EnvironmentLacksError: matplotlib is not installed, or there is no space.
    """
    drawn = runs.Drawn(
        tuple(EXAMPLES) if example is None else (example,), epsilon, gain, robust, identifier
    )
    figures.require()
    extended = [
        *([studies.fitted(drawn.examples)] if fit else []),
        *([studies.discretised(drawn.examples)] if discrete else []),
        *([studies.searched(drawn.examples)] if search else []),
    ]
    started = time.monotonic()
    with _folder(output, drawn) as folder, _disk(folder):
        with _Told() as told:
            extra = [
                Task(SCENARIOS[n], sampled, (n,), lane) for lane, n in enumerate(drawn.examples)
            ]
            extra += [task for study in extended for task in study.tasks]
            results = runs.compute(drawn, extra, told)
            told("drawing", 1, 1)
            files = figures.draw_all(results.curves, drawn, folder)
            files += series.write_all(results.curves, drawn, folder)
        found = _summary(drawn, results, extended)
        tables = {study.title: study.markdown(results.extra) for study in extended}
        files += summary.write(found, tables, folder)
    if json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        _show(found, Console(file=sys.stdout))
        sys.stdout.write(f"{folder / 'summary.md'} says what each number is; {len(files)} files\n")
    print(f"{time.monotonic() - started:.0f} s", file=sys.stderr)
    return 0


def sampled(number: int) -> Sampled:
    """Run an example through the product's own path: 1 kHz, frames, noise; in a worker.

    Args:
        number: Of the example.

    Raises:
        InputError: The shipped scenario is wrong.
    """
    opened = session.open_session(SCENARIOS[number])
    warm_up(opened)
    run, outcome = run_simulation(opened, progress=False)
    example = EXAMPLES[number]
    t = run.cycle["t"]
    late = running_mask(run) & (t >= example.fault_s + example.settle_s)
    true = rho_at(run, t[late])
    estimate = run.cycle["rho_hat"][late, 0]
    difference = estimate - true[:, 0] if true is not None else np.full(len(estimate), np.nan)
    error = tracking_error(run)[late] * 1e3
    return Sampled(
        rms(difference),
        tuple(rms(column) for column in error.T),
        tuple(largest(column) for column in error.T),
        outcome.end_state,
    )


def _summary(
    drawn: runs.Drawn, results: runs.Results, extended: Sequence[studies.Study]
) -> dict[str, Any]:
    found, targets = [], []
    for number in drawn.examples:
        noisy = results.extra[SCENARIOS[number]]
        judge = Judge(EXAMPLES[number], results.measures, drawn, noisy)
        found += judge.findings()
        targets += judge.targets()
    failed = {name: m.failed for name, m in results.measures.items() if m.failed is not None}
    plain = {study.key: study.plain(results.extra) for study in extended}
    return summary.collect(found, targets, drawn, failed, plain)


def _show(found: dict[str, Any], console: Console) -> None:
    """Print a line for each figure, and what our observer reached."""
    console.print(f"Fig.  {'claim':<{_CLAIM}}  {'measured':>{_VALUE}}  verdict", soft_wrap=True)
    for figure in found["figures"]:
        value = f"{summary.number(figure['rows'][0]['number'])} {figure['unit']}".rstrip()
        claim = set_cell_size(figure["claim"], _CLAIM)
        line = Text(f"{figure['figure']:4}  {claim}  {value:>{_VALUE}}  ")
        verdict = figure["verdict"]
        line.append(verdict, {REPRODUCES: "green", CONDITIONAL: "yellow"}.get(verdict, "bold red"))
        for condition in figure["conditions"]:
            line.append(f":\n      {condition}")
        console.print(line, soft_wrap=True)
    for target in found["targets"]:
        state = "reached" if target["met"] else "missed"
        console.print(
            f"Example {target['example']}, our ρ̂, {target['title']}: RMSE "
            f"{summary.number(target['number'])}, to reach {target['limit']:g}: {state}",
            highlight=False,
            soft_wrap=True,
        )


@contextlib.contextmanager
def _folder(output: str | Path, drawn: runs.Drawn) -> Iterator[Path]:
    """The folder to write to, checked; what was made for nothing is removed again."""
    if not os.fspath(output):
        raise InputError("--output", "''", "a folder to write to")
    folder = Path(output)
    missing = [each for each in (folder, *folder.parents) if not os.path.lexists(each)][::-1]
    made: list[Path] = []
    try:
        try:
            for each in missing:
                each.mkdir()
                made.append(each)
        except OSError as error:
            raise InputError(
                str(folder), f"cannot be made: {error.strerror}", "a folder to write to"
            ) from None
        if not folder.is_dir():
            raise InputError(str(folder), "is a file", "a folder to write to")
        for name in _files(drawn):
            check_output(folder / name)
        yield folder
    finally:
        with contextlib.suppress(OSError):  # there is something in it: it has been used
            for each in reversed(made):
                each.rmdir()


def _files(drawn: runs.Drawn) -> list[str]:
    """Names of everything that will be written."""
    numbers = [
        figures.PER_EXAMPLE * (example - 1) + k
        for example in drawn.examples
        for k in range(1, figures.PER_EXAMPLE + 1)
    ]
    drawings = [f"{figures.name(n)}.{end}" for n in numbers for end in ("png", "svg", "csv")]
    return ["summary.json", "summary.md", *drawings]


@contextlib.contextmanager
def _disk(folder: Path) -> Iterator[None]:
    """A disk that fills up while files are written is no fault of the input."""
    try:
        yield
    except OSError as error:
        if isinstance(error, (InputError, EnvironmentLacksError)):
            raise
        raise EnvironmentLacksError(f"{folder}: {error.strerror}", "free some space") from None


class _Told:
    """Progress on standard error: a bar on a terminal, else a line now and then."""

    def __init__(self) -> None:
        self._next = time.monotonic() + _PLAIN_S
        self._bar: Progress | None = None
        if sys.stderr.isatty():
            self._bar = Progress(
                TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
                TimeElapsedColumn(), console=Console(stderr=True), transient=True,
            )  # fmt: skip
            self._task = self._bar.add_task("compiling and simulating", total=None)

    def __enter__(self) -> _Told:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, name: str, done: int, total: int) -> None:
        if self._bar is not None:
            self._bar.update(self._task, description=name, completed=done, total=total)
        elif time.monotonic() >= self._next:
            self._next = time.monotonic() + _PLAIN_S
            print(f"{done} of {total} runs: {name}", file=sys.stderr, flush=True)
