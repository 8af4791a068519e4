"""The loop under a clock and with drives that the test controls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import (
    ExecutorTable,
    ReferenceTable,
    RobotTable,
    Scenario,
    SupervisorTable,
)
from dftc_rt.control import signals
from dftc_rt.drives.interface import GOAL_OFF, GOAL_OPERATE
from dftc_rt.memory import MemorySink
from dftc_rt.reference import Reference
from dftc_rt.rt.clock import FakeClock
from dftc_rt.rt.drive_link import DriveLink
from dftc_rt.rt.executor import Executor, Outcome
from dftc_rt.rt.limits import JointLimits
from dftc_rt.rt.supervisor import State

F64 = NDArray[np.float64]
PERIOD = 1_000_000  # ns
JOINTS = ("shoulder", "elbow")
HEADER = 7
RUN, DEGRADED, FINISH, ARM, STOP, FAULT = (
    State.RUN, State.DEGRADED, State.FINISH, State.ARM, State.SAFE_STOP, State.FAULT,
)  # fmt: skip
LIMITS = JointLimits(np.full(2, -2.0), np.full(2, 2.0), np.full(2, 3.0), np.full(2, 100.0))
FAULT_BIT = 0x0008
ENABLED = 0x0027
READY = 0x0021


class Link:
    """Drives in memory: enabled at the third cycle, disabled when told."""

    def __init__(self, clock: FakeClock) -> None:
        self.clock = clock
        self.q, self.v = np.array([0.1, -0.2]), np.zeros(2)
        self.age, self.status = np.zeros(2), np.zeros(2, dtype=np.int64)
        self.emergency = np.zeros(2, dtype=np.int64)
        self.sent = np.zeros(2)
        self.missed = 3
        self.refused = 0
        self.fault = ""
        self.abandoned = False
        self.goal = GOAL_OFF
        self.enables = True
        self.disables = True
        self.ticks: list[tuple[int, int, int]] = []  # number, deadline, when
        self.commands: list[tuple[float, bool, int]] = []  # torque of joint 0, wanted, goal
        self.cost: dict[int, int] = {}  # cycle -> ns that its exchange takes
        self.on_cycle: Callable[[int], None] = lambda k: None

    def exchange(self, number: int, deadline: int) -> None:
        self.ticks.append((number, deadline, self.clock.now()))
        self.clock.time += self.cost.get(number, 0)
        if self.goal == GOAL_OPERATE and self.enables and number >= 2:
            self.status[self.status == 0] = ENABLED
        self.on_cycle(number)

    def command(self, tau: F64, torque: bool = True) -> None:
        self.sent[:] = np.round(tau, 1) if torque else 0.0
        self.commands.append((float(tau[0]), torque, self.goal))

    def all_enabled(self) -> bool:
        return self.enables and self.goal == GOAL_OPERATE and len(self.ticks) >= 3

    def first_not_enabled(self) -> int:
        return 1

    def first_live(self) -> int:
        return -1 if self.disables and self.goal != GOAL_OPERATE else 0

    def abandon(self) -> None:
        self.abandoned = True


class Law:
    """Commands a constant; claims what it is told to claim."""

    uses_local_terms = False
    ftc = True

    def __init__(self) -> None:
        self.tau = np.array([1.23, -4.56])
        self.rho = np.ones(2)
        self.verdict = np.zeros(2)
        self.failing = np.zeros(2, dtype=bool)
        self.status = 0
        self.skipped: list[int] = []
        self.started_at: F64 | None = None

    def start(self, q: F64, v: F64) -> None:
        self.started_at = q.copy()

    def skip(self, ticks: int) -> None:
        self.skipped.append(ticks)

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        rec[signals.S] = np.where(self.failing, np.nan, 0.0)
        rec[signals.TAU_LAW] = 2.0 * self.tau
        rec[signals.TAU_CMD] = self.tau
        rec[signals.RHO_HAT] = self.rho
        rec[signals.VERDICT] = self.verdict
        return self.status


class NoTerms:
    inertia = bias = load = np.zeros(2)

    def update(self, *_: object) -> None:
        raise AssertionError("this law uses no local terms")


class Bench:
    """An executor with everything around it at hand."""

    def __init__(
        self, clock: Any = None, home: tuple[float, float] = (0.1, -0.2), **tables: Any
    ) -> None:
        supervisor = {
            "stop_ramp_s": 0.010,
            "velocity_factor": 1.5,
            "saturation_s": 0.005,
            "brake_s": 0.004,
            **tables.pop("supervisor", {}),
        }
        scenario = Scenario(
            name="bench",
            robot=RobotTable(name="arm2"),
            duration_s=0.020,
            executor=ExecutorTable(**tables.pop("executor", {})),
            supervisor=SupervisorTable(**supervisor),
        )
        self.clock = clock or FakeClock()
        self.link = Link(self.clock if clock is None else FakeClock())
        self.link.q[:] = home
        self.law = Law()
        self.sink = MemorySink(HEADER + len(signals.NAMES) * 2)
        self.events: list[tuple[float, int, str, str]] = []
        self.stop_at = 10**9
        self.shut_down_after = 0
        self.unconfirmed: tuple[str, ...] = ()
        reference = Reference(ReferenceTable(kind="hold", blend_s=0.0), self.link.q.copy())
        self.executor = Executor(
            scenario, JOINTS, LIMITS, self.clock, cast(DriveLink, self.link),
            self.law, reference, NoTerms(), None, self.sink,
            lambda *event: self.events.append(event),
            lambda: len(self.link.ticks) > self.stop_at, self.shut_down,
        )  # fmt: skip

    def shut_down(self) -> tuple[str, ...]:
        self.shut_down_after = len(self.link.ticks)
        return self.unconfirmed

    def run(self) -> Outcome:
        return self.executor.run()

    @property
    def records(self) -> F64:
        return self.sink.records()

    @property
    def states(self) -> list[int]:
        """States in order, repetitions left out."""
        column = self.records[:, 4].astype(int).tolist()
        return [s for i, s in enumerate(column) if i == 0 or s != column[i - 1]]

    def row(self, row: int) -> F64:
        return self.records[:, HEADER:].reshape(-1, len(signals.NAMES), 2)[:, row]

    @property
    def texts(self) -> list[str]:
        return [text for _, _, _, text in self.events]
