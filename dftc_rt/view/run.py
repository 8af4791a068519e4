"""A run that is going on, as the page reads it: newest records, and how busy the buses are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dftc_rt.dynamics.model import Robot
from dftc_rt.view.snapshot import Snapshot

F64 = NDArray[np.float64]


@dataclass
class LiveRun:
    """Where a run is read.

    Attributes:
        robot: The robot.
        cycle, rig: Give a copy of the newest record of each ring; None before the first.
        buses: Logical bus names.
        busy: Gives rig time and time busy of each bus, (buses, 2), s.
    """

    robot: Robot
    cycle: Callable[[], F64 | None]
    rig: Callable[[], F64 | None]
    buses: tuple[str, ...]
    busy: Callable[[], F64]
    _before: F64 | None = field(default=None)
    _loads: F64 | None = field(default=None)

    def now(self) -> Snapshot | None:
        """The newest moment; None before the first cycle."""
        cycle = self.cycle()
        return None if cycle is None else Snapshot.of_records(cycle, self.rig(), self.robot.n)

    def loads(self) -> F64:
        """Share of time that each bus was busy since it last told, (buses,); NaN: not yet."""
        told = self.busy()
        if self._before is None or self._loads is None:
            self._before, self._loads = told, np.full(len(self.buses), np.nan)
        fresh = told[:, 0] > self._before[:, 0]
        change = told[fresh] - self._before[fresh]
        self._loads[fresh] = change[:, 1] / change[:, 0]
        self._before[fresh] = told[fresh]
        return self._loads
