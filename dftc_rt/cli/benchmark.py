"""``dftc benchmark``: robots, faults and laws compared, in parallel and resumable."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from cyclopts import Parameter
from rich.console import Console

from dftc_rt.benchmark import figures, frozen
from dftc_rt.benchmark.cases import INTERCONNECTIONS, KINDS, VARIANTS, groups
from dftc_rt.benchmark.conditions import ROBOTS, SEEDS, seed
from dftc_rt.benchmark.negative import ITEMS
from dftc_rt.benchmark.store import RESULTS, load_faults
from dftc_rt.cli import benchmark_runs
from dftc_rt.cli import benchmark_work as work
from dftc_rt.cli.benchmark_files import PAGE, Chosen, Files, joints_of
from dftc_rt.errors import InputError
from dftc_rt.pool import available

_NEGATIVE_LAWS = ("dftc", "momentum")


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
    freeze: bool = False,
    set_: Sequence[str] = (),
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
        momentum_threshold: Factor on the calibrated threshold_loss of the law momentum; default:
            the frozen one, else 1.
        freeze: Find the least such factor at which momentum gives no more false alarms than
            dftc on the negative set, and write frozen.toml, which the sealed draw needs.
        set_: Override a key of every run's scenario, ``a.b=value``; may be repeated.
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
    folder = _folder(output)
    fixed = _frozen(folder, draw, freeze, momentum_threshold)
    for name in chosen.robots if set_ else ():
        benchmark_runs.check_settings(name, set_)
    files = Files(folder, draw, workers)
    known = work.calibrate_all(
        chosen.robots, folder / "calibration", *chosen.calibration,
        keep_calibration or draw == "sealed", workers, set_,
    )  # fmt: skip
    if draw == "sealed" and fixed is not None:
        frozen.check(fixed, known.marks, str(folder / frozen.FROZEN))
    files.read(known)
    factor = momentum_threshold or (1.0 if fixed is None else fixed.momentum_threshold)
    repeats = work.passes(hours, len(chosen.robots), chosen.items)
    if freeze:
        files.negative(chosen, [("dftc", "desired", 1.0)], repeats)
        fixed = files.freeze(chosen)
        factor = fixed.momentum_threshold
    if part != "negative":
        numbers = [seed("faults", draw, k) for k in range(count)]
        wanted = groups(chosen.robots, chosen.laws, chosen.interconnections, factor, draw, numbers)
        files.cases(chosen, wanted)
    if part != "faults":
        variants = [
            (name, where, factor if name == "momentum" else 1.0)
            for name in chosen.negative_laws
            for where in (chosen.interconnections if interconnection else ("desired",))
            if where in VARIANTS[name].interconnections
        ]
        files.negative(chosen, variants, repeats)
    found = files.page(factor, fixed if draw == "sealed" else None)
    if json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        _show(found["aims"], Console(file=sys.stdout))
        sys.stdout.write(f"{folder / PAGE} has the tables\n")
    return 0


def _frozen(folder: Path, draw: str, freeze: bool, factor: float | None) -> frozen.Frozen | None:
    """What has been frozen; refuses what does not go with it."""
    path = folder / frozen.FROZEN
    if freeze:
        if draw == "sealed":
            raise InputError("--freeze", "with --draw sealed", "--draw tuning")
        if factor is not None:
            raise InputError("--freeze", "with --momentum-threshold", "one of them")
        if any(row.draw == "sealed" for row in load_faults(folder / RESULTS)):
            what = "the sealed draw has been run with what is frozen there"
            raise InputError(str(path), what, "another folder")
        return None
    if draw == "sealed":
        if factor is not None:
            raise InputError("--momentum-threshold", "with --draw sealed", "what is frozen")
        return frozen.load(path)
    return frozen.load(path) if path.exists() else None


def _show(found: Sequence[Mapping[str, Any]], console: Console) -> None:
    words = {True: "yes", False: "no", None: "open"}
    for aim in found:
        line = f"{words[aim['met']]:4} {aim['aim']}: {aim['reached']} ({aim['cases']})"
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
    _check("--joint", joint, tuple(name for each in robots for name in joints_of(each)))
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
