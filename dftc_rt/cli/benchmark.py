"""``dftc benchmark``: robots, faults and laws compared, in parallel and resumable."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from cyclopts import Parameter
from rich.console import Console

from dftc_rt.benchmark import aims, figures, page
from dftc_rt.benchmark.cases import INTERCONNECTIONS, KINDS, VARIANTS, groups
from dftc_rt.benchmark.conditions import ROBOTS, SEEDS, seed
from dftc_rt.benchmark.negative import ITEMS
from dftc_rt.benchmark.rows import FAULT_COLUMNS, NEGATIVE_COLUMNS
from dftc_rt.benchmark.select import Rows
from dftc_rt.benchmark.store import NEGATIVE, RESULTS, load_faults, load_negative
from dftc_rt.cli import benchmark_work as work
from dftc_rt.config.robot import load_robot_config
from dftc_rt.errors import InputError
from dftc_rt.pool import available

PAGE = "benchmark.md"
_NEGATIVE_LAWS = ("dftc", "momentum")


@dataclass(frozen=True)
class Chosen:
    """What is to be run, defaults filled in.

    Attributes:
        robots: Keys of ``ROBOTS``.
        laws: Keys of ``VARIANTS``.
        negative_laws: The same, for the negative set.
        kinds: Keys of ``KINDS``.
        joints: Joints to put faults on; all if empty.
        interconnections: Settings of ``control.interconnection``.
        calibration: Runs and seconds.
        items: Number of items of the negative set, from the first.
    """

    robots: Sequence[str]
    laws: Sequence[str]
    negative_laws: Sequence[str]
    kinds: Sequence[str]
    joints: Sequence[str]
    interconnections: Sequence[str]
    calibration: tuple[int, float]
    items: int


def benchmark(
    what: Literal["faults"],
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    robot: Sequence[str] = (),
    law: Sequence[str] = (),
    kind: Sequence[str] = (),
    joint: Sequence[str] = (),
    interconnection: Sequence[str] = (),
    seeds: int | None = None,
    draw: Literal["tuning", "sealed"] = "tuning",
    part: Literal["faults", "negative", "all"] = "all",
    hours: float = 0.0,
    momentum_threshold: float | None = None,
    keep_calibration: bool = False,
    jobs: int | None = None,
    quick: bool = False,
    json: bool = False,
) -> int:
    """Compare laws on robots with faults, and count their false alarms without.

    Every case is a row of results.csv, every run without a fault one of negative.csv; both
    are written as they come, and the command goes on where it was interrupted. Rows that other
    sources or another calibration made are moved to a file beside.

    Example::

        dftc benchmark faults -o benchmark --law dftc --kind loss40 --seeds 3

    Args:
        what: faults.
        output: Folder to write to; made if it is not there.
        robot: panda, ur5, ur10, xarm7; may be repeated, as the next four; default: all.
        law: dftc, dftc_gain_off, computed_torque, momentum, eso, adaptive, oracle.
        kind: loss20, loss40, loss70, ramp, sine, intermittent, total, two, recovery.
        joint: Joint to put faults on, if it is loaded.
        interconnection: desired, measured, frozen; of the law dftc.
        seeds: Number of seeds; default 10.
        draw: Which seeds: those to tune with, or those of the published numbers.
        part: Runs with faults, the negative set without, or both.
        hours: Repeat the negative set with new seeds until each law has run for so long.
        momentum_threshold: Factor on the calibrated threshold_loss of the law momentum.
        keep_calibration: Do not calibrate anew what was calibrated by other sources.
        jobs: Worker processes; default: one for each core.
        quick: A few cases after a short calibration: does it work?
        json: Print one JSON object on stdout.

    Returns:
        Exit code.

    Raises:
        InputError: An option is wrong, or the folder cannot be written.
    """
    chosen = _chosen(robot, law, kind, joint, interconnection, quick)
    count = (1 if quick else 10) if seeds is None else seeds
    _check_numbers(count, hours, jobs, momentum_threshold)
    figures.require()
    workers = available() if jobs is None else jobs
    factor = 1.0 if momentum_threshold is None else momentum_threshold
    folder = _folder(output)
    results, negatives = folder / RESULTS, folder / NEGATIVE
    faults, healthy = load_faults(results), load_negative(negatives)
    joints = {name: _joints(name) for name in chosen.robots}
    known = work.calibrate_all(
        chosen.robots, folder / "calibration", *chosen.calibration, keep_calibration, workers
    )
    faults = work.current(results, FAULT_COLUMNS, faults, known.marks, _say)
    healthy = work.current(negatives, NEGATIVE_COLUMNS, healthy, known.marks, _say)
    if part != "negative":
        numbers = [seed("faults", draw, k) for k in range(count)]
        wanted = groups(chosen.robots, chosen.laws, chosen.interconnections, factor, draw, numbers)
        tasks = work.fault_tasks(wanted, chosen.kinds, joints, chosen.joints, faults, known)
        faults = work.compute("faults", tasks, results, FAULT_COLUMNS, faults, workers)
    if part != "faults":
        variants = [
            (name, where, factor if name == "momentum" else 1.0)
            for name in chosen.negative_laws
            for where in (chosen.interconnections if interconnection else ("desired",))
            if where in VARIANTS[name].interconnections
        ]
        items = ITEMS[: chosen.items]
        repeats = work.passes(hours, len(chosen.robots), len(items))
        todo = work.negative_tasks(
            chosen.robots, variants, draw, repeats, items, healthy, known
        )  # fmt: skip
        healthy = work.compute("no fault", todo, negatives, NEGATIVE_COLUMNS, healthy, workers)
    rows = Rows.of(draw, factor, faults, healthy)
    facts = page.Facts(factor, known.marks, None)
    drawn = figures.draw_all(rows, folder)
    text = page.markdown(rows, facts, drawn)
    (folder / PAGE).write_text(text, encoding="utf-8")
    found = page.as_json(rows, facts)
    if json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        _show(aims.aims(rows), Console(file=sys.stdout))
        sys.stdout.write(f"{folder / PAGE} has the tables\n")
    return 0


def _show(found: Sequence[aims.Aim], console: Console) -> None:
    words = {True: "yes", False: "no", None: "open"}
    for aim in found:
        line = f"{words[aim.met]:4} {aim.title}: {aim.reached} ({aim.n})"
        console.print(line, highlight=False, soft_wrap=True)


def _chosen(
    robot: Sequence[str],
    law: Sequence[str],
    kind: Sequence[str],
    joint: Sequence[str],
    interconnection: Sequence[str],
    quick: bool,
) -> Chosen:
    _check("--robot", robot, tuple(ROBOTS))
    _check("--law", law, tuple(VARIANTS))
    _check("--kind", kind, tuple(KINDS))
    _check("--interconnection", interconnection, INTERCONNECTIONS)
    robots = tuple(robot) or (("ur5",) if quick else tuple(ROBOTS))
    _check("--joint", joint, tuple(name for each in robots for name in _joints(each)))
    return Chosen(
        robots,
        tuple(law) or (("dftc",) if quick else tuple(VARIANTS)),
        tuple(law) or (("dftc",) if quick else _NEGATIVE_LAWS),
        tuple(kind) or (("loss40", "total") if quick else tuple(KINDS)),
        tuple(joint),
        tuple(interconnection) or (("desired",) if quick else INTERCONNECTIONS),
        (1, 10.0) if quick else (3, 30.0),
        2 if quick else len(ITEMS),
    )


def _check(option: str, given: Sequence[str], known: Sequence[str]) -> None:
    for each in given:
        if each not in known:
            raise InputError(option, f"found '{each}'", "one of " + ", ".join(known))


def _check_numbers(seeds: int, hours: float, jobs: int | None, factor: float | None) -> None:
    if not 1 <= seeds <= SEEDS:
        raise InputError("--seeds", f"found {seeds}", f"1 to {SEEDS}")
    if not 0.0 <= hours <= 1000.0:
        raise InputError("--hours", f"found {hours:g}", "0 to 1000")
    if jobs is not None and not 1 <= jobs <= 256:
        raise InputError("--jobs", f"found {jobs}", "1 to 256")
    if factor is not None and not 0.01 <= factor <= 1e4:
        raise InputError("--momentum-threshold", f"found {factor:g}", "0.01 to 10000")


def _joints(robot: str) -> tuple[str, ...]:
    return tuple(joint.name for joint in load_robot_config(robot)[0].joint)


def _folder(output: Path) -> Path:
    """The folder, made; refuses what cannot be one."""
    if not os.fspath(output) or str(output) == ".":
        raise InputError("--output", f"'{output}'", "a folder to write to")
    try:
        output.mkdir(parents=True, exist_ok=True)
        probe = output / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        what = f"cannot be written: {error.strerror}"
        raise InputError(str(output), what, "a folder to write to") from None
    return output


def _say(text: str) -> None:
    print(f"dftc: {text}", file=sys.stderr, flush=True)
