"""The fixed-rate loop: read, update, write, record, wait for the next tick.

Real time and lock-step run this same code; they differ in the clock and in how the
exchange waits (docs/architecture.md, "One cycle").
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import Scenario
from dftc_rt.control import interface, signals
from dftc_rt.drives.interface import GOAL_OFF, GOAL_OPERATE, GOAL_STOP
from dftc_rt.reference import Reference, stop_ramp
from dftc_rt.rt import supervisor as sup
from dftc_rt.rt.clock import NS, Clock
from dftc_rt.rt.drive_link import DriveLink
from dftc_rt.rt.supervisor import State, Supervisor

F64 = NDArray[np.float64]

HEADER: Final = ("t", "lateness", "compute", "exchange", "state", "overruns", "skipped")
_MOVING: Final = (State.RUN, State.SAFE_STOP, State.FINISH)
_ARM_TIMEOUT_S: Final = 5.0
_DISABLE_TIMEOUT_S: Final = 1.0


class RecordSink(Protocol):
    """Where records go: a ring to the recorder, or memory."""

    def slot(self) -> F64:
        """Return where to write the next record, (width,). Real-time safe."""
        ...

    def commit(self) -> bool:
        """Hand the slot over; False when the record was dropped. Real-time safe."""
        ...


class ExactTerms(Protocol):
    """Local dynamics of every joint at any state."""

    inertia: F64
    bias: F64
    load: F64

    def update(self, q: F64, v: F64, qd: F64, vd: F64, ad: F64) -> None:
        """Refresh ``inertia``, ``bias`` and ``load``, (n,) each. Real-time safe."""
        ...


class TableTerms(Protocol):
    """Local dynamics of every joint along the reference."""

    inertia: F64
    bias: F64
    load: F64
    motion: F64

    def update(self, k: int, q: F64, v: F64) -> None:
        """Refresh ``inertia``, ``bias`` and ``load`` for cycle ``k`` of the run. Real-time safe."""
        ...


EventFunction = Callable[[float, int, str, str], object]
"""Called as (t, severity, source, text)."""

DEBUG, INFO, WARNING, ERROR = range(4)


@dataclass
class Counters:
    """What a run counts.

    Attributes:
        cycles: Cycles run.
        overruns: Ticks that came while the previous cycle was still at work.
        skipped: Ticks left out by policy ``skip`` or ``stop``.
        missed: Answers that did not come within the read budget, over all joints.
        refused: Frames that a bus did not take.
    """

    cycles: int = 0
    overruns: int = 0
    skipped: int = 0
    missed: int = 0
    refused: int = 0


@dataclass
class Outcome:
    """How a run ended.

    Attributes:
        end_state: ``done``, ``interrupted`` or ``safe stop``.
        reason: One line; empty when done.
        counters: What was counted.
    """

    end_state: str = "done"
    reason: str = ""
    counters: Counters = field(default_factory=Counters)


class Executor:
    """Runs one controller for one robot."""

    def __init__(
        self,
        scenario: Scenario,
        joints: tuple[str, ...],
        torque_limit: F64,
        clock: Clock,
        link: DriveLink,
        law: interface.Law,
        reference: Reference,
        exact: ExactTerms,
        table: TableTerms | None,
        sink: RecordSink,
        event: EventFunction,
        stop_requested: Callable[[], bool],
        shutdown: Callable[[], Sequence[str]],
    ) -> None:
        """Put the parts together; nothing moves before :meth:`run`.

        Args:
            scenario: The resolved scenario.
            joints: Names, in order.
            torque_limit: (n,), Nm.
            clock: Real, lock-step or fake.
            link: The drives, configured, their pose known.
            law: The control law.
            reference: Desired motion, blending in from the measured pose.
            exact: Local terms, off the reference and where there is no table.
            table: Local terms along the reference, or None to use the exact ones.
            sink: Takes one record a cycle.
            event: Takes events.
            stop_requested: Polled once a cycle: the operator wants a safe stop.
            shutdown: Takes power off every drive after the loop, however it ended; returns
                the joints whose drive did not confirm.
        """
        n = len(joints)
        self._joints = joints
        self._clock = clock
        self._link = link
        self._law = law
        self._reference = reference
        self._exact = exact
        self._table = table
        self._sink = sink
        self._event = event
        self._stop_requested = stop_requested
        self._shutdown = shutdown
        self._period_ns = round(NS / scenario.executor.rate_hz)
        self._period = 1.0 / scenario.executor.rate_hz
        self._supervisor = Supervisor(scenario.supervisor, torque_limit, self._period)
        self._run_cycles = max(round(scenario.duration_s * scenario.executor.rate_hz), 1)
        self._ramp_s = scenario.supervisor.stop_ramp_s
        self._overrun = scenario.executor.overrun
        self.record = np.zeros(len(HEADER) + len(signals.NAMES) * n)
        self._rec = self.record[len(HEADER) :].reshape(len(signals.NAMES), n)
        self._desired = self._rec[signals.QD : signals.AD + 1]
        self._ramp_from = np.zeros((3, n))
        self.outcome = Outcome()
        self._state = State.IDLE
        self._phase_start = 0  # cycle at which the present state began
        self._drop_told = False
        self.t = 0.0  # scheduled time of the present cycle, s
        self.first_tick = 0  # when the clock shows t = 0, ns; known when the loop begins

    # -- life of a run ------------------------------------------------------------------

    def run(self) -> Outcome:
        """Arm the drives, run to the end or to a safe stop, and disable the drives.

        However the loop ends, by an exception too, power is taken off every drive that can
        still be reached.

        Raises:
            BusError: A bus has gone away.
        """
        try:
            self._loop()
        except BaseException:
            self._link.abandon()
            raise
        finally:
            self.outcome.counters.missed = self._link.missed
            self.outcome.counters.refused = self._link.refused
            for joint in self._shutdown():
                self._event(self.t, WARNING, "controller", f"{joint}: power off not confirmed")
        return self.outcome

    def _loop(self) -> None:
        clock, link, counters = self._clock, self._link, self.outcome.counters
        self._start()
        first_tick = self.first_tick = clock.now() + self._period_ns
        k = 0
        while self._going():
            self.t = k * self._period
            deadline = first_tick + k * self._period_ns
            clock.sleep_until(deadline)
            started = clock.now()
            link.exchange(k, deadline)
            read_done = clock.now()
            self._update(k)
            computed = clock.now()
            torque = self._state is not State.FAULT and self._state is not State.IDLE
            link.command(self._rec[signals.TAU_CMD], torque)
            self._rec[signals.TAU_CMD] = link.sent
            written = clock.now()
            counters.cycles += 1
            lateness = 0 if clock.lockstep else started - deadline
            self._record(k, lateness, computed - read_done,
                         read_done - started + written - computed)  # fmt: skip
            k = self._next_tick(k, first_tick)

    def _going(self) -> bool:
        return self._state is not State.IDLE

    def _start(self) -> None:
        """Start the law at the measured pose and begin to arm."""
        link, rec = self._link, self._rec
        rec[signals.Q], rec[signals.V] = link.q, link.v
        self._law.start(link.q, link.v)
        self._ramp_from[0] = link.q
        link.goal = GOAL_OPERATE
        self._enter(State.ARM, 0, INFO, "arming")

    def _next_tick(self, k: int, first_tick: int) -> int:
        """Return the next cycle's number; apply the overrun policy when it is late."""
        if self._clock.lockstep:
            return k + 1
        behind = self._clock.now() - (first_tick + (k + 1) * self._period_ns)
        if behind <= 0:
            return k + 1
        counters = self.outcome.counters
        counters.overruns += 1
        if self._overrun == "catch_up":
            return k + 1
        if self._overrun == "stop" and self._state is State.RUN:
            self._safe_stop(k, "overrun: the cycle took longer than its period", ramp=True)
        missed = int(behind // self._period_ns)
        counters.skipped += missed
        if missed:
            self._law.skip(missed)
        return k + 1 + missed

    # -- one cycle ----------------------------------------------------------------------

    def _update(self, k: int) -> None:
        """Law, gain and supervision of one cycle, and its state changes."""
        link, rec, law = self._link, self._rec, self._law
        rec[signals.Q] = link.q
        rec[signals.V] = link.v
        rec[signals.AGE] = link.age
        rec[signals.STATUS] = link.status
        state = self._state
        self.record[4] = state
        elapsed = k - self._phase_start
        if state is State.RUN and self._table is not None:
            self._desired[:] = self._table.motion[min(elapsed, self._run_cycles - 1)]
        elif state is State.RUN:
            self._reference.sample(elapsed * self._period, self._desired)
        elif state is State.ARM:
            self._desired[0] = self._ramp_from[0]
            self._desired[1:] = 0.0
        else:
            stop_ramp(elapsed * self._period, self._ramp_s, self._ramp_from, self._desired)
        terms: ExactTerms | TableTerms = self._exact
        if law.uses_local_terms:
            if self._table is not None and state <= State.RUN:
                terms = self._table
                self._table.update(elapsed if state is State.RUN else 0, link.q, link.v)
            else:
                self._exact.update(link.q, link.v, *self._desired)
        status = law.update(rec, terms.inertia, terms.bias, terms.load)
        violation, joint = self._supervisor.check(rec, link.status, state in _MOVING)
        if status and violation == sup.OK:
            violation, joint = sup.NOT_FINITE, int(np.argmax(np.isnan(rec[signals.S])))
        self._transition(k, elapsed, violation, joint)

    def _transition(self, k: int, elapsed: int, violation: int, joint: int) -> None:
        """Edges of the supervisor's graph."""
        state = self._state
        if state is State.FAULT:
            live = self._link.first_live()
            if live < 0 and elapsed > 0:
                self._enter(State.IDLE, k, INFO, "drives disabled, brakes closed")
            elif elapsed * self._period >= _DISABLE_TIMEOUT_S:
                text = f"did not say within {_DISABLE_TIMEOUT_S} s that it is off"
                self._enter(State.IDLE, k, ERROR, f"{self._joints[live]}: {text}")
            return
        if self._link.fault:  # commands do not get through, or not all: no ramp
            self._safe_stop(k, self._link.fault, ramp=False)
            return
        if violation != sup.OK and self._react(k, violation, joint):
            return
        if state is State.ARM:
            if self._link.all_enabled():
                self._enter(State.RUN, k + 1, INFO, "running")
            elif elapsed * self._period >= _ARM_TIMEOUT_S:
                who = self._joints[self._link.first_not_enabled()]
                self._safe_stop(k, f"{who}: the drive was not enabled in {_ARM_TIMEOUT_S} s", False)
            elif self._stop_requested():
                self._interrupt(k, ramp=False)
        elif state is State.RUN:
            if self._stop_requested():
                self._interrupt(k, ramp=True)
            elif elapsed + 1 >= self._run_cycles:
                self._ramp_from[:] = self._desired
                self._enter(State.FINISH, k, INFO, "duration reached, coming to rest")
        elif elapsed * self._period >= self._ramp_s:
            self._link.goal = GOAL_OFF
            self._enter(State.FAULT, k, INFO, "at rest, disabling the drives")

    def _react(self, k: int, violation: int, joint: int) -> bool:
        """Stop for a violation; return whether the state changed.

        A violation that can be ramped down stands while the ramp lasts: it is no second one.
        """
        reason = self._supervisor.reason(violation, self._joints[joint])
        if violation in sup.UNCONTROLLED or self._state is State.ARM:
            self._safe_stop(k, reason, ramp=False)
            return True
        if self._state is not State.RUN:
            if self.outcome.end_state == "done":
                self.outcome.end_state, self.outcome.reason = "safe stop", reason
            return False
        self._safe_stop(k, reason, ramp=True)
        if violation == sup.TRACKING:  # from where the joint is, not from where it should be
            self._ramp_from[0, joint] = self._rec[signals.Q, joint]
            self._ramp_from[1, joint] = self._rec[signals.V, joint]
        return True

    def _interrupt(self, k: int, ramp: bool) -> None:
        self._safe_stop(k, "stop requested by the operator", ramp)
        self.outcome.end_state = "interrupted"

    def _safe_stop(self, k: int, reason: str, ramp: bool) -> None:
        """Begin a ramp to rest, or, where that cannot be trusted, quick-stop the drives."""
        if self.outcome.end_state == "done":
            self.outcome.end_state, self.outcome.reason = "safe stop", reason
        if ramp:
            self._ramp_from[:] = self._desired
            self._enter(State.SAFE_STOP, k, ERROR, f"safe stop: {reason}")
        else:
            self._link.goal = GOAL_STOP
            self._enter(State.FAULT, k, ERROR, f"quick stop: {reason}")

    def _enter(self, state: State, k: int, severity: int, text: str) -> None:
        self._state = state
        self._phase_start = k
        self._event(k * self._period, severity, "controller", text)

    def _record(self, k: int, lateness: int, compute: int, exchange: int) -> None:
        record = self.record
        record[0] = k * self._period
        record[1] = lateness * 1e-9
        record[2] = compute * 1e-9
        record[3] = exchange * 1e-9
        record[5] = self.outcome.counters.overruns
        record[6] = self.outcome.counters.skipped
        self._sink.slot()[:] = record
        if not self._sink.commit() and not self._drop_told:
            self._drop_told = True
            self._event(record[0], WARNING, "controller", "the recorder does not keep up")
