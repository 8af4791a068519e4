"""The executor over a log: its loop, law, estimators, decision, gain and limits as they run.

Nothing of the control is written anew here. Where this replay would have told the drives
something else than the log says, the law is told what they were told: it is that which they
obeyed, and which the feedback answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.control.interface import Law
from dftc_rt.control.signals import NAMES
from dftc_rt.controller import assemble
from dftc_rt.drives.interface import profile
from dftc_rt.drives.wiring import bus_names, robot_drives
from dftc_rt.errors import LogError
from dftc_rt.log.run import Run, Signals, split
from dftc_rt.log.schema import CYCLE_HEADER, cycle_layout
from dftc_rt.replay.causes import causes
from dftc_rt.replay.link import EndOfLog, LogClock, LoggedLink, numbers
from dftc_rt.replay.stored import Stored
from dftc_rt.ring import Event
from dftc_rt.rt.clock import NS
from dftc_rt.rt.executor import Executor, Outcome
from dftc_rt.rt.supervisor import FOLLOWING

F64 = NDArray[np.float64]

MEASURED: Final = ("lateness", "compute", "exchange")
"""Fields that a clock has measured: no replay can have them."""
_STATE: Final = CYCLE_HEADER.index("state")


@dataclass(frozen=True)
class Replayed:
    """What the executor made of a log.

    Attributes:
        cycle: Rows of ``/cycle``, as many as could be replayed; what a clock measures, as logged.
        events: The controller's.
        outcome: How the run ended, where it did.
        ended: Whether the executor came to its own end.
        parted: Whether the last row is in another state than the log's: from there on nothing
            can be replayed, because the motion that was logged is of that other state. Run and
            degraded are the same motion.
    """

    cycle: Signals
    events: tuple[Event, ...]
    outcome: Outcome
    ended: bool
    parted: bool


class _Parted(Exception):
    """The replay is in another state than the log."""


def replay(stored: Stored, run: Run, where: str = "the log") -> Replayed:
    """Run the executor over a log.

    Args:
        stored: The controller, from :func:`dftc_rt.replay.stored.controller_of`.
        run: The log.
        where: Its name, for messages.

    Raises:
        LogError: The log does not begin with the run, or was written by another version.
    """
    log, scenario, robot = run.cycle, stored.scenario, stored.parts.robot
    missing = [name for name in (*CYCLE_HEADER, *NAMES) if name not in log]
    if missing:
        raise LogError(where, f"no field {missing[0]} in /cycle", "a log of this version of dftc")
    if run.joints != robot.joints:
        raise LogError(where, f"joints {', '.join(run.joints)}", ", ".join(robot.joints))
    rate = scenario.executor.rate_hz
    period_ns = round(NS / rate)
    cycles = numbers(log["t"], period_ns)
    if not len(cycles) or cycles[0] != 0:
        found = f"begins with cycle {cycles[0]}" if len(cycles) else "holds no cycle"
        raise LogError(where, found, "a log of the run from its first cycle on")
    clock = LogClock()
    drives = robot_drives(robot, scenario.bus)
    buses = bus_names(robot.joint_config)
    outside = causes(run.events, rate, robot.joints, buses)
    link = LoggedLink(
        profile(scenario.bus.profile).cycle(drives, len(buses), rate), log, period_ns, clock,
        outside, stored.parts.torque_limit,
    )  # fmt: skip
    link.start_logged()
    sink = _Comparing(link, log, stored.parts.law, log["tau_cmd"] * stored.units)
    events: list[Event] = []

    def event(t: float, severity: int, source: str, text: str) -> None:
        events.append(Event(t, severity, source, text))

    executor = assemble(
        scenario, stored.parts, link, clock, sink, event,
        lambda: int(cycles[link.at]) in outside.stops, tuple,
    )  # fmt: skip
    sink.executor = executor
    ended, parted = False, False
    try:
        executor.run()
        ended = True
    except EndOfLog:
        pass
    except _Parted:
        parted = True
    cycle = split(cycle_layout(run.joints, NAMES), sink.records[: sink.count])
    for name in MEASURED:
        cycle[name] = log[name][: sink.count]
    outcome = executor.outcome
    if parted:  # what it made of a cycle of another state is void
        events = [each for each in events if each.t < cycle["t"][-1] - 0.5 / rate]
        outcome = Outcome(*sink.before, outcome.counters)
    return Replayed(cycle, tuple(events), outcome, ended, parted)


class _Comparing:
    """Takes the records; ends the replay where the log is in another state."""

    def __init__(self, link: LoggedLink, log: Signals, law: Law, told: F64) -> None:
        count, n = told.shape
        self.records = np.zeros((count, len(CYCLE_HEADER) + len(NAMES) * n))
        self.count = 0
        self.executor: Executor | None = None
        self.before = ("done", "")  # how the run had ended, and why, up to the last record
        self._link = link
        self._states = log["state"]
        self._law = law
        self._told = told

    def slot(self) -> F64:
        """Return where the next record goes."""
        row: F64 = self.records[self.count]
        return row

    def commit(self) -> bool:
        """Keep the record, and tell the law what was sent where it was something else."""
        at = self.count
        self.count += 1
        states = self.records[at, _STATE], self._states[at]
        if states[0] != states[1] and not set(states) <= set(FOLLOWING):
            raise _Parted
        if self.executor is not None:
            outcome = self.executor.outcome
            self.before = outcome.end_state, outcome.reason
        told = self._told[at]
        for joint in np.flatnonzero(told != self._link.sent):
            self._law.told(int(joint), float(told[joint]))
        return True
