"""The folder of ``dftc benchmark``: rows, what is frozen, and the page."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from dftc_rt.benchmark import figures, frozen, page, sweep
from dftc_rt.benchmark.cases import Group
from dftc_rt.benchmark.negative import ITEMS
from dftc_rt.benchmark.rows import (
    FAULT_COLUMNS,
    NEGATIVE_COLUMNS,
    SWEEP_COLUMNS,
    FaultRow,
    NegativeRow,
    SweepRow,
)
from dftc_rt.benchmark.select import Rows
from dftc_rt.benchmark.store import (
    NEGATIVE,
    RESULTS,
    SWEEP,
    load_faults,
    load_negative,
    load_sweep,
)
from dftc_rt.cli import benchmark_work as work
from dftc_rt.config.robot import load_robot_config
from dftc_rt.errors import InputError

PAGE: Final = "benchmark.md"


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


class Files:
    """Rows of a folder, and more of them.

    Attributes:
        faults: Twins and cases.
        healthy: Runs of the negative set.
        swept: Alarms of ``momentum`` at many thresholds.
    """

    def __init__(self, folder: Path, draw: str, jobs: int) -> None:
        """Name the folder.

        Args:
            folder: It is there.
            draw: ``tuning`` or ``sealed``.
            jobs: Worker processes.
        """
        self._folder = folder
        self._draw = draw
        self._jobs = jobs
        self._known = work.Calibrations({}, {})
        self.faults: list[FaultRow] = []
        self.healthy: list[NegativeRow] = []
        self.swept: list[SweepRow] = []

    def read(self, known: work.Calibrations) -> None:
        """Read what is there; rows of other sources are moved aside.

        Raises:
            InputError: A file is none of ours.
        """
        self._known = known
        marks, at = known.marks, self._folder
        self.faults = work.current(
            at / RESULTS, FAULT_COLUMNS, load_faults(at / RESULTS), marks, _say
        )
        self.healthy = work.current(
            at / NEGATIVE, NEGATIVE_COLUMNS, load_negative(at / NEGATIVE), marks, _say
        )
        self.swept = work.current(at / SWEEP, SWEEP_COLUMNS, load_sweep(at / SWEEP), marks, _say)

    def cases(self, chosen: Chosen, wanted: Sequence[Group]) -> None:
        """Run the cases that are missing."""
        joints = {name: joints_of(name) for name in chosen.robots}
        tasks = work.fault_tasks(
            wanted, chosen.kinds, joints, chosen.joints, self.faults, self._known
        )
        path = self._folder / RESULTS
        self.faults = work.compute("faults", tasks, path, FAULT_COLUMNS, self.faults, self._jobs)

    def negative(
        self, chosen: Chosen, variants: Sequence[tuple[str, str, float]], repeats: int
    ) -> None:
        """Run what is missing of the negative set.

        Args:
            chosen: Robots and items.
            variants: Law, interconnection, factor on the threshold of ``momentum``.
            repeats: Passes.
        """
        tasks = work.negative_tasks(
            chosen.robots, variants, self._draw, repeats, ITEMS[: chosen.items], self.healthy,
            self._known,
        )  # fmt: skip
        path = self._folder / NEGATIVE
        self.healthy = work.compute(
            "no fault", tasks, path, NEGATIVE_COLUMNS, self.healthy, self._jobs
        )

    def freeze(self, chosen: Chosen) -> frozen.Frozen:
        """Find the threshold of ``momentum``, and write down what is frozen.

        Raises:
            InputError: It gives more false alarms than ``dftc`` at every threshold.
        """
        rows = Rows.of(self._draw, 1.0, (), self.healthy)
        ours = [row for row in rows.healthy() if row.robot in chosen.robots]
        tasks = work.sweep_tasks(ours, self.swept, self._known)
        path = self._folder / SWEEP
        self.swept = work.compute("thresholds", tasks, path, SWEEP_COLUMNS, self.swept, self._jobs)
        same = {(row.robot, row.seed, row.item) for row in ours}
        theirs = [row for row in self.swept if (row.robot, row.seed, row.item) in same]
        counts = np.sum([[int(x) for x in row.counts.split()] for row in theirs], axis=0)
        alarms = sum(row.false_alarms for row in ours)
        hours, theirs_hours = (
            sum(row.simulated_s for row in each) / 3600.0 for each in (ours, theirs)
        )
        # Runs that end in a safe stop are shorter: what counts is the rate.
        found = sweep.least_factor(counts, int(alarms * theirs_hours / hours + 1e-9))
        if found is None:
            what = f"more than the {alarms} false alarms of dftc at every threshold"
            raise InputError("law momentum", what)
        fixed = frozen.stamped(
            frozen.Frozen(
                when=time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
                momentum_threshold=found[0],
                dftc_alarms=alarms,
                dftc_hours=hours,
                momentum_alarms=found[1],
                momentum_hours=theirs_hours,
                fingerprints=dict(self._known.marks),
            )
        )
        frozen.write(fixed, self._folder / frozen.FROZEN)
        _say(f"frozen: momentum at {found[0]:g} times its threshold_loss")
        return fixed

    def page(self, factor: float, fixed: frozen.Frozen | None) -> dict[str, Any]:
        """Write figures and page; return the aims and the extent, ready for JSON.

        Args:
            factor: On the threshold of ``momentum``, of the rows to be shown.
            fixed: What was frozen, for the sealed draw.

        Raises:
            InputError: A file cannot be written.
        """
        rows = Rows.of(self._draw, factor, self.faults, self.healthy)
        facts = page.Facts(factor, self._known.marks, fixed, self._known.settings)
        drawn = figures.draw_all(rows, self._folder)
        path = self._folder / PAGE
        try:
            path.write_text(page.markdown(rows, facts, drawn), encoding="utf-8")
        except OSError as error:
            raise InputError(str(path), f"cannot be written: {error.strerror}") from None
        return page.as_json(rows, facts)


def joints_of(robot: str) -> tuple[str, ...]:
    """Joints of a robot, in the model's order."""
    return tuple(joint.name for joint in load_robot_config(robot)[0].joint)


def _say(text: str) -> None:
    print(f"dftc: {text}", file=sys.stderr, flush=True)
