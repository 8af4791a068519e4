"""Time several things turn by turn, so that a busy machine is as busy for each of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Samples:
    """Time of one thing, µs a call, one entry a block.

    Attributes:
        wall: By the clock on the wall.
        cpu: Processor time of this process, all its threads.
    """

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)

    @property
    def median(self) -> float:
        """Median of the wall time, µs."""
        return float(np.median(self.wall))

    @property
    def least(self) -> float:
        """Least wall time, µs."""
        return min(self.wall)

    @property
    def cpu_median(self) -> float:
        """Median of the processor time, µs."""
        return float(np.median(self.cpu))

    def add(self, calls: int, wall_ns: int, cpu_ns: int) -> None:
        """Take one block of ``calls`` calls."""
        self.wall.append(wall_ns / calls / 1e3)
        self.cpu.append(cpu_ns / calls / 1e3)


def ratio(of: list[float], to: list[float]) -> float:
    """Median over the rounds of one thing's time over the other's in the same round."""
    return float(np.median(np.divide(of, to)))


def measure(
    things: Mapping[str, Callable[[int], object]], rounds: int, calls: int
) -> dict[str, Samples]:
    """Time each of ``things`` once a round, after one round that does not count.

    Args:
        things: Name -> function that makes as many calls as it is told.
        rounds: How often each gets its turn.
        calls: Calls of one turn.
    """
    found = {name: Samples() for name in things}
    for number in range(rounds + 1):
        for name, run in things.items():
            wall, cpu = time.perf_counter_ns(), time.process_time_ns()
            run(calls)
            cpu, wall = time.process_time_ns() - cpu, time.perf_counter_ns() - wall
            if number:
                found[name].add(calls, wall, cpu)
    return found
