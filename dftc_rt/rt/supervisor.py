"""The supervisor: the states of a run and every way from one to another, as one table.

    idle -> configure -> arm -> run <-> degraded -> finish -> fault -> idle
                          |      |         |          |
                          +------+---------+-> safe stop or at once -> fault

``finish`` and ``safe stop`` bring the arm to rest under control, then hand it to the
brakes. Where control cannot do that any more, the drives are quick-stopped instead, at
once; where they cannot be reached, their own watchdogs do it. A stop is legal from every
state: :data:`EDGES` has one for each, and docs/safety.md shows the same rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import SupervisorTable
from dftc_rt.rt import limits
from dftc_rt.rt.limits import BY_VIOLATION, OK, JointLimits

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

ARM_TIMEOUT_S: Final = 5.0
OFF_TIMEOUT_S: Final = 1.0


class State(IntEnum):
    """State of the run, as logged in ``/cycle``."""

    IDLE = 0
    CONFIGURE = 1
    ARM = 2
    RUN = 3
    DEGRADED = 4
    SAFE_STOP = 5
    FAULT = 6
    FINISH = 7


MOVING: Final = (State.RUN, State.DEGRADED, State.SAFE_STOP, State.FINISH)
"""States in which every drive must be in operation enabled."""

FOLLOWING: Final = (State.RUN, State.DEGRADED)
"""States in which the arm follows its reference."""


class Trigger(StrEnum):
    """What makes the run leave a state; the text is that of the documentation."""

    OPENED = "the buses are open"
    READY = "every drive answers, is what the robot file says, and its pose is within limits"
    REFUSED = "a start-up check fails, or the operator stops"
    ENABLED = "every drive is in operation enabled, and probed if asked for"
    NOT_ARMED = "some drive is not, or moves against its torque, or not at all"
    LOSS = "verdict actuator loss on some joint"
    NO_LOSS = "no such verdict any more"
    DURATION = "`duration_s` is over"
    OPERATOR = "operator stop (SIGINT, SIGTERM, SIGHUP)"
    RAMP = "a limit of the kind *ramp*"
    QUICK = "a limit of the kind *quick stop*"
    AT_REST = "the ramp is over"
    OFF = "every drive is off, and the brakes had their time"
    NOT_OFF = "some drive does not say that it is off"
    GONE = "a bus goes away, or an error of the loop itself"


class Action(StrEnum):
    """What is done on the way; the text is that of the documentation."""

    CONFIGURE = "set the drives up, power on, no torque"
    ENABLE = "enable; hold the measured pose"
    FOLLOW = "follow the reference, blended in from the measured pose"
    NOTE = "note it"
    RAMP = "bring the reference to rest under control"
    KEEP_RAMP = "the ramp goes on; note it"
    QUICK_STOP = "quick stop in every drive, no torque"
    DISABLE = "torque off, brakes close"
    END = "power off by service message; end"
    LAST_WORD = "quick stop as the last word on every bus that is left; power off; end"


SAME_CYCLE: Final = "the same cycle"
_RAMP_OVER: Final = "`stop_ramp_s`"


@dataclass(frozen=True, slots=True)
class Edge:
    """One way from a state to another.

    Attributes:
        source: State that is left.
        trigger: What makes the run leave it.
        target: State that is entered.
        action: What is done.
        deadline: How soon, as documented.
    """

    source: State
    trigger: Trigger
    target: State
    action: Action
    deadline: str = SAME_CYCLE


def _ways_down(source: State) -> tuple[Edge, ...]:
    """Return the stops of a state in which the arm follows its reference."""
    return (
        Edge(source, Trigger.QUICK, State.FAULT, Action.QUICK_STOP),
        Edge(source, Trigger.RAMP, State.SAFE_STOP, Action.RAMP),
        Edge(source, Trigger.OPERATOR, State.SAFE_STOP, Action.RAMP),
        Edge(source, Trigger.DURATION, State.FINISH, Action.RAMP),
        Edge(source, Trigger.GONE, State.IDLE, Action.LAST_WORD),
    )


def _on_the_ramp(source: State) -> tuple[Edge, ...]:
    """Return the edges of a state in which the arm is brought to rest."""
    return (
        Edge(source, Trigger.QUICK, State.FAULT, Action.QUICK_STOP),
        Edge(source, Trigger.RAMP, source, Action.KEEP_RAMP),
        Edge(source, Trigger.OPERATOR, source, Action.KEEP_RAMP),
        Edge(source, Trigger.AT_REST, State.FAULT, Action.DISABLE, _RAMP_OVER),
        Edge(source, Trigger.GONE, State.IDLE, Action.LAST_WORD),
    )


EDGES: Final = (
    Edge(State.IDLE, Trigger.OPENED, State.CONFIGURE, Action.CONFIGURE, "1 s for each answer"),
    Edge(State.CONFIGURE, Trigger.READY, State.ARM, Action.ENABLE),
    Edge(State.CONFIGURE, Trigger.REFUSED, State.IDLE, Action.END, "0.1 s for each answer"),
    Edge(State.CONFIGURE, Trigger.GONE, State.IDLE, Action.LAST_WORD),
    Edge(State.ARM, Trigger.ENABLED, State.RUN, Action.FOLLOW),
    Edge(State.ARM, Trigger.NOT_ARMED, State.FAULT, Action.QUICK_STOP, f"{ARM_TIMEOUT_S:g} s"),
    Edge(State.ARM, Trigger.QUICK, State.FAULT, Action.QUICK_STOP),
    Edge(State.ARM, Trigger.RAMP, State.FAULT, Action.QUICK_STOP),
    Edge(State.ARM, Trigger.OPERATOR, State.FAULT, Action.QUICK_STOP),
    Edge(State.ARM, Trigger.GONE, State.IDLE, Action.LAST_WORD),
    Edge(State.RUN, Trigger.LOSS, State.DEGRADED, Action.NOTE),
    *_ways_down(State.RUN),
    Edge(State.DEGRADED, Trigger.NO_LOSS, State.RUN, Action.NOTE),
    *_ways_down(State.DEGRADED),
    *_on_the_ramp(State.FINISH),
    *_on_the_ramp(State.SAFE_STOP),
    Edge(State.FAULT, Trigger.OFF, State.IDLE, Action.END, "`brake_s`"),
    Edge(State.FAULT, Trigger.NOT_OFF, State.IDLE, Action.END, f"{OFF_TIMEOUT_S:g} s"),
    Edge(State.FAULT, Trigger.GONE, State.IDLE, Action.LAST_WORD),
)
"""Every edge. OPENED and REFUSED are taken by set-up, before there is a loop."""

_BY_SOURCE: Final = {(edge.source, edge.trigger): edge for edge in EDGES}


def edge(source: State, trigger: Trigger) -> Edge | None:
    """Return the edge that a trigger takes, or None where it means nothing. Real-time safe."""
    return _BY_SOURCE.get((source, trigger))


class Supervisor:
    """Watches every cycle of a run."""

    def __init__(self, table: SupervisorTable, joints: JointLimits, period_s: float) -> None:
        """Take the limits.

        Args:
            table: The scenario's ``[supervisor]``.
            joints: What each joint may do.
            period_s: Control period, s.
        """
        n = joints.torque.shape[0]
        self._table = table
        self._joints = joints.rows(table, period_s)
        self._limits = limits.numbers(table, period_s)
        self._counts = np.zeros((2, n), dtype=np.int64)
        self._before = np.full(n, np.nan)
        self._late_limit = table.overruns_in_a_row

    def check(
        self, rec: F64, statusword: I64, emergency: I64, state: State, late: int
    ) -> tuple[int, int]:
        """Return (violation, joint index), (OK, -1) when all is well. Real-time safe.

        Args:
            rec: The cycle's record, (15, n).
            statusword: CiA 402 statusword of each drive, (n,).
            emergency: Last emergency error code of each drive, (n,); 0: none.
            state: Of the run.
            late: Overruns in a row.
        """
        phase = 1 if state in MOVING else 0 if state is State.ARM else 2
        violation, joint = limits.find(
            rec, statusword, emergency, self._counts, self._before, self._joints, self._limits,
            phase,
        )  # fmt: skip
        if violation == OK and late >= self._late_limit:
            return limits.OVERRUNS, -1
        return violation, joint

    def reason(self, violation: int, joint: int, name: str, detail: str = "") -> str:
        """Return the violation as a line for people.

        Args:
            violation: From :meth:`check`.
            joint: Index of the joint, -1 where it is none's.
            name: Its name.
            detail: What the law raised.
        """
        table = self._table
        limit: object = {
            limits.STALE: table.stale_cycles,
            limits.TRACKING: table.tracking_error_rad,
            limits.RUNAWAY: 2.0 * table.tracking_error_rad,
            limits.RHO_LOW: table.rho_min,
            limits.SATURATED: table.saturation_s,
            limits.POSITION: table.position_margin_rad,
            limits.OVERRUNS: table.overruns_in_a_row,
            limits.LAW_RAISED: detail,
        }.get(violation)
        row = {limits.VELOCITY: 2, limits.OVERSPEED: 2, limits.TORQUE: 3, limits.TORQUE_RATE: 4}
        if violation in row:
            scale = 2.0 if violation == limits.OVERSPEED else 1.0
            limit = f"{scale * self._joints[row[violation], joint]:.4g}"
        text = BY_VIOLATION[violation].reason.format(limit=limit)
        return text if joint < 0 else f"{name}: {text}"
