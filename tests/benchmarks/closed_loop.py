"""One simulation as ``dftc simulate`` does it, timed from its first cycle to its last."""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from dftc_rt.cli.session import Session, open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.log.run import Run
from dftc_rt.rt.executor import Executor, Outcome


@dataclass(frozen=True)
class Timed:
    """A run and its time.

    Attributes:
        opened: The session.
        run: What was recorded.
        cycles: Control cycles, arming and coming to rest included.
        wall_ns: From the first cycle until all is written.
        cpu_ns: The same in processor time of this process, all its threads.
    """

    opened: Session
    run: Run
    cycles: int
    wall_ns: int
    cpu_ns: int


def simulate(scenario: str, settings: Sequence[str], log: Path | None = None) -> Timed:
    """Run a scenario; set-up (loading, tabulating, configuring drives) is not counted.

    Args:
        scenario: Name of a shipped scenario.
        settings: Overrides, ``key=value``.
        log: Write the run to this file; the time until it is closed counts.

    Raises:
        RuntimeError: The run did not come to its end.
    """
    opened = open_session(scenario, settings)
    started: list[tuple[int, int]] = []
    plain = Executor.run

    def run(executor: Executor) -> Outcome:
        started.append((time.perf_counter_ns(), time.process_time_ns()))
        return plain(executor)

    gc.collect()
    recorder = None if log is None else opened.recorder(log, epoch_ns=0)
    with mock.patch.object(Executor, "run", run), recorder or nullcontext():
        found, outcome = run_simulation(opened, recorder, progress=False)
    wall, cpu = time.perf_counter_ns(), time.process_time_ns()
    if outcome.end_state != "done":
        raise RuntimeError(f"{scenario} {list(settings)}: {outcome.end_state}, {outcome.reason}")
    return Timed(opened, found, outcome.counters.cycles, wall - started[0][0], cpu - started[0][1])
