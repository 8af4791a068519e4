"""What ``dftc benchmark`` still has to compute, and the workers that do it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import dftc_rt
from dftc_rt.benchmark import negative, sources, sweep
from dftc_rt.benchmark.cases import Group, partner
from dftc_rt.benchmark.conditions import NEGATIVE_S, seed
from dftc_rt.benchmark.rows import FaultRow, NegativeRow, SweepRow
from dftc_rt.benchmark.store import AnyRow, Store, set_aside
from dftc_rt.cli import benchmark_runs, benchmark_sweep
from dftc_rt.cli.benchmark_progress import Progress
from dftc_rt.pool import Task, run

ROOT: Final = Path(dftc_rt.__file__).resolve().parents[1]
SLOTS: Final = 32
"""Seeds of a pass over the negative set: more than it has items, so that it may grow."""


@dataclass(frozen=True)
class Calibrations:
    """Where the calibrations are, and what rows made with them are marked with.

    Attributes:
        files: Robot -> file.
        marks: Robot -> fingerprint of sources, file and settings.
        settings: Further overrides of every run's scenario.
    """

    files: Mapping[str, str]
    marks: Mapping[str, str]
    settings: Sequence[str] = ()

    def arguments(self, group: Group) -> tuple[Group, str, str, Sequence[str]]:
        """What every worker's function takes first."""
        return group, self.files[group.robot], self.marks[group.robot], self.settings


def calibrate_all(
    robots: Sequence[str],
    folder: Path,
    runs: int,
    seconds: float,
    keep: bool,
    jobs: int,
    settings: Sequence[str] = (),
) -> Calibrations:
    """Make the calibrations that are missing, or that other sources would make otherwise.

    Args:
        robots: Which.
        folder: Of the calibrations; made if it is not there.
        runs: Simulated runs for the model, and again for the statistics.
        seconds: Length of each, s.
        keep: Take those that are there, whatever they were made with.
        jobs: Worker processes.
        settings: Further overrides of the runs that are made with them; not of these.
    """
    folder.mkdir(exist_ok=True)
    made_with = sources.digest(sources.read_all(ROOT, sources.CALIBRATION))
    stamp = f"{made_with} {runs} x {seconds:g} s\n"
    tasks = []
    for robot in robots:
        path, note = folder / f"{robot}.toml", folder / f"{robot}.stamp"
        if path.exists() and (keep or (note.exists() and note.read_text() == stamp)):
            continue
        note.unlink(missing_ok=True)
        tasks.append(
            Task(robot, benchmark_runs.make_calibration, (robot, str(path), runs, seconds))
        )
    with Progress("calibrating", len(tasks)) as told:

        def done(task: Task) -> None:
            (folder / f"{task.name}.stamp").write_text(stamp)
            told.done()

        run(tasks, jobs, done)
    every = sources.read_all(ROOT, sources.ROWS)
    files = {robot: str((folder / f"{robot}.toml").resolve()) for robot in robots}
    marks = {
        robot: sources.digest(
            [
                *every,
                ("calibration", Path(path).read_bytes()),
                *((f"setting {k}", each.encode()) for k, each in enumerate(settings)),
            ]
        )
        for robot, path in files.items()
    }
    return Calibrations(files, marks, tuple(settings))


def current(
    path: Path,
    columns: Mapping[str, str],
    rows: Sequence[AnyRow],
    marks: Mapping[str, str],
    say: Callable[[str], None],
) -> list[AnyRow]:
    """Rows of these sources and calibrations; the others are moved to a file beside.

    Rows of robots that are not asked for now stay as they are.

    Args:
        path: The results file.
        columns: Its columns.
        rows: Its rows.
        marks: Robot -> fingerprint.
        say: Told about what has been moved.
    """
    kept = [row for row in rows if marks.get(row.robot, row.fingerprint) == row.fingerprint]
    stale = [row for row in rows if marks.get(row.robot, row.fingerprint) != row.fingerprint]
    if stale:
        files = set_aside(path, list(columns), stale)
        names = ", ".join(file.name for file in files)
        say(f"{len(stale)} rows of other sources or another calibration moved to {names}")
    return kept


def fault_tasks(
    wanted: Sequence[Group],
    kinds: Sequence[str],
    joints: Mapping[str, Sequence[str]],
    only: Sequence[str],
    rows: Sequence[FaultRow],
    known: Calibrations,
) -> list[Task]:
    """Tasks for what is not among the rows.

    Args:
        wanted: Groups.
        kinds: Kinds of fault.
        joints: Robot -> its joints.
        only: Joints to put faults on; all if there are none.
        rows: What is there already.
        known: Calibrations.
    """
    by_group: dict[str, dict[str, FaultRow]] = defaultdict(dict)
    for row in rows:
        by_group[row.id.rsplit("/", 2)[0]][row.id] = row
    tasks = []
    for group in wanted:
        there = by_group.get(group.id, {})
        twins = [row for row in there.values() if row.kind == "twin"]
        every = joints[group.robot]
        if len(twins) < len(every):  # none, or the run was interrupted between them
            twins = []
        chosen = [joint for joint in every if not only or joint in only]
        cases = _missing(group, kinds, chosen, there, twins)
        if cases:
            tasks.append(
                Task(
                    group.id,
                    benchmark_runs.fault_rows,
                    (*known.arguments(group), cases, not twins),
                )
            )
    return tasks


def _missing(
    group: Group,
    kinds: Sequence[str],
    joints: Sequence[str],
    there: Mapping[str, FaultRow],
    twins: Sequence[FaultRow],
) -> list[tuple[str, str]]:
    """Kind and joint of cases that are not there, as far as is known before the twin has run."""
    every = [(kind, joint) for kind in kinds for joint in joints]
    if not twins:
        return every
    if any(row.end_state != "done" for row in twins):
        return []
    loaded = [row.joint for row in twins if row.loaded]
    return [
        (kind, joint)
        for kind, joint in every
        if joint in loaded
        and group.case_id(kind, joint) not in there
        and not (kind == "two" and partner(loaded, joint) is None)
    ]


def negative_tasks(
    robots: Sequence[str],
    variants: Sequence[tuple[str, str, float]],
    draw: str,
    passes: int,
    items: Sequence[negative.Item],
    rows: Sequence[NegativeRow],
    known: Calibrations,
) -> list[Task]:
    """Tasks for what is not among the rows.

    Args:
        robots: Which.
        variants: Law, interconnection, factor on the threshold of ``momentum``.
        draw: ``tuning`` or ``sealed``.
        passes: How often the whole set is run, each time with other seeds.
        items: The set.
        rows: What is there already.
        known: Calibrations.
    """
    there = {row.id for row in rows}
    tasks = []
    for number in range(passes):
        for index, item in enumerate(items):
            for robot in robots:
                for name, where, factor in variants:
                    own = seed("negative", draw, number * SLOTS + index)
                    group = Group(robot, name, where, factor, draw, own)
                    if negative.item_id(group, item.name) in there:
                        continue
                    tasks.append(
                        Task(
                            negative.item_id(group, item.name),
                            benchmark_runs.negative_rows,
                            (*known.arguments(group), [item]),
                        )
                    )
    return tasks


def sweep_tasks(
    healthy: Sequence[NegativeRow], rows: Sequence[SweepRow], known: Calibrations
) -> list[Task]:
    """Tasks for runs of ``momentum`` without a threshold, beside runs of ``dftc``.

    Args:
        healthy: The runs of ``dftc``.
        rows: What is there already.
        known: Calibrations.
    """
    there = {row.id for row in rows}
    items = {item.name: item for item in negative.ITEMS}
    tasks = []
    for row in healthy:
        group = Group(row.robot, "momentum", "desired", sweep.NO_THRESHOLD, row.draw, row.seed)
        name = negative.item_id(group, row.item)
        if name not in there:
            arguments = (*known.arguments(group), items[row.item])
            tasks.append(Task(name, benchmark_sweep.sweep_rows, arguments))
    return tasks


def passes(hours: float, robots: int, items: int) -> int:
    """Passes over the negative set that make up some hours of simulated time, at least one."""
    one = robots * items * NEGATIVE_S / 3600.0
    return max(1, -int(-hours // one))


def compute(
    what: str,
    tasks: Sequence[Task],
    path: Path,
    columns: Mapping[str, str],
    rows: Sequence[AnyRow],
    jobs: int,
) -> list[AnyRow]:
    """Run tasks, and write their rows to the file as they come; return all rows.

    Args:
        what: For people.
        tasks: Generators of rows.
        path: Results file.
        columns: Its columns.
        rows: What is there already.
        jobs: Worker processes.
    """
    every = list(rows)
    store = Store(path, list(columns), every)
    try:
        with Progress(what, len(tasks)) as told:

            def item(_: Task, row: Any) -> None:
                store.append(row)
                every.append(row)
                told.row()

            run(tasks, jobs, lambda _: told.done(), item)
    finally:
        store.close()
    return every
