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
from dftc_rt.rt import limits
from dftc_rt.rt.clock import NS, Clock
from dftc_rt.rt.drive_link import DriveLink
from dftc_rt.rt.limits import BY_VIOLATION, JointLimits, first_loss
from dftc_rt.rt.sign_probe import Finding, SignProbe
from dftc_rt.rt.supervisor import (
    ARM_TIMEOUT_S,
    FOLLOWING,
    OFF_TIMEOUT_S,
    Action,
    State,
    Supervisor,
    Trigger,
    edge,
)

F64 = NDArray[np.float64]

HEADER: Final = ("t", "lateness", "compute", "exchange", "state", "overruns", "skipped")
_STOPS: Final = (Trigger.QUICK, Trigger.RAMP, Trigger.OPERATOR, Trigger.NOT_ARMED)
_OPERATOR: Final = "stop requested by the operator"
_FROM_WHERE_IT_IS: Final = frozenset({limits.TRACKING, limits.POSITION, limits.VELOCITY})


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
        joint_limits: JointLimits,
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
            joint_limits: What each joint may do.
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
        self._supervisor = Supervisor(scenario.supervisor, joint_limits, self._period)
        self._run_cycles = max(round(scenario.duration_s * scenario.executor.rate_hz), 1)
        self._ramp_s = scenario.supervisor.stop_ramp_s
        self._brake_s = scenario.supervisor.brake_s
        self._overrun = scenario.executor.overrun
        self.record = np.zeros(len(HEADER) + len(signals.NAMES) * n)
        self._rec = self.record[len(HEADER) :].reshape(len(signals.NAMES), n)
        self._desired = self._rec[signals.QD : signals.AD + 1]
        self._ramp_from = np.zeros((3, n))
        self.outcome = Outcome()
        self._state = State.CONFIGURE  # set-up is done: nothing is enabled
        self._phase_start = 0  # cycle at which the present phase began
        self._late = 0  # overruns in a row
        probe = scenario.supervisor.probe
        self._probe = SignProbe(probe, joint_limits.torque, self._period) if probe else None
        self._probing = False
        self._law_error = ""
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
        self._take(0, Trigger.READY, "arming")

    def _next_tick(self, k: int, first_tick: int) -> int:
        """Return the next cycle's number; apply the overrun policy when it is late."""
        if self._clock.lockstep:
            return k + 1
        behind = self._clock.now() - (first_tick + (k + 1) * self._period_ns)
        if behind <= 0:
            self._late = 0
            return k + 1
        counters = self.outcome.counters
        counters.overruns += 1
        self._late += 1
        if self._overrun == "catch_up":
            return k + 1
        if self._overrun == "stop" and self._state in FOLLOWING:
            self._stop_for(k, limits.OVERRUN, -1)
        missed = int(behind // self._period_ns)
        counters.skipped += missed
        if missed:
            self._law.skip(missed)
        return k + 1 + missed

    # -- one cycle ----------------------------------------------------------------------

    def _update(self, k: int) -> None:
        """Law, gain and supervision of one cycle, and its state changes."""
        link, rec = self._link, self._rec
        rec[signals.Q] = link.q
        rec[signals.V] = link.v
        rec[signals.AGE] = link.age
        rec[signals.STATUS] = link.status
        state = self._state
        self.record[4] = state
        elapsed = k - self._phase_start
        following = state in FOLLOWING
        if following and self._table is not None:
            self._desired[:] = self._table.motion[min(elapsed, self._run_cycles - 1)]
        elif following:
            self._reference.sample(elapsed * self._period, self._desired)
        elif state is State.ARM:
            self._desired[0] = self._ramp_from[0]
            self._desired[1:] = 0.0
        else:
            stop_ramp(elapsed * self._period, self._ramp_s, self._ramp_from, self._desired)
        of_law, where = self._run_law(elapsed if following else -1)
        if self._probing and self._probe is not None:
            self._probe.step(rec, self._exact.inertia)
        violation, joint = self._supervisor.check(
            rec, link.status, link.emergency, state, self._late
        )
        if of_law == limits.LAW_RAISED or violation == limits.OK:
            violation, joint = of_law, where
        self._transition(k, elapsed, violation, joint)

    def _run_law(self, elapsed: int) -> tuple[int, int]:
        """Update the law; return what it did wrong, and on which joint.

        Args:
            elapsed: Cycles since the reference began, -1 off the reference.
        """
        link, rec, law = self._link, self._rec, self._law
        if self._state is State.FAULT:  # no torque goes out, and nothing is to be learnt from that
            rec[signals.TAU_LAW] = rec[signals.TAU_CMD] = 0.0
            return limits.OK, -1
        terms: ExactTerms | TableTerms = self._exact
        try:
            if law.uses_local_terms:
                if self._table is not None and (elapsed >= 0 or self._state is State.ARM):
                    terms = self._table
                    self._table.update(min(max(elapsed, 0), self._run_cycles - 1), link.q, link.v)
                else:
                    self._exact.update(link.q, link.v, *self._desired)
            status = law.update(rec, terms.inertia, terms.bias, terms.load)
        except Exception as error:  # somebody else's code: whatever it raises, the drives stop
            self._law_error = f"{type(error).__name__}: {error}"
            rec[signals.TAU_LAW] = rec[signals.TAU_CMD] = 0.0
            return limits.LAW_RAISED, -1
        if status:
            return limits.NOT_FINITE, int(np.argmax(np.isnan(rec[signals.S])))
        return limits.OK, -1

    def _transition(self, k: int, elapsed: int, violation: int, joint: int) -> None:
        """Take the edge of :data:`dftc_rt.rt.supervisor.EDGES` that this cycle calls for."""
        state = self._state
        seconds = elapsed * self._period
        if state is State.FAULT:
            self._await_brakes(k, elapsed)
            return
        if violation != limits.OK:
            self._stop_for(k, violation, joint)
        elif self._link.fault:  # commands do not get through, or not all: no ramp
            self._take(k, Trigger.QUICK, self._link.fault)
        elif self._stop_requested():
            self._take(k, Trigger.OPERATOR, _OPERATOR)
        if self._state is not state:
            return
        if state is State.ARM:
            if self._link.all_enabled():
                self._begin(k)
            elif seconds >= ARM_TIMEOUT_S:
                who = self._joints[self._link.first_not_enabled()]
                text = f"{who}: the drive was not enabled in {ARM_TIMEOUT_S} s"
                self._take(k, Trigger.NOT_ARMED, text)
        elif state in FOLLOWING:
            self._follow(k, elapsed)
        elif seconds >= self._ramp_s:
            self._take(k, Trigger.AT_REST, "at rest, disabling the drives")

    def _begin(self, k: int) -> None:
        """Follow the reference, once the probe has found nothing wrong."""
        link, probe = self._link, self._probe
        if probe is None:
            self._take(k + 1, Trigger.ENABLED, "running")
        elif not self._probing:
            self._exact.update(link.q, link.v, *self._desired)
            self._probing = True
        elif probe.finding is Finding.RIGHT:
            self._probing = False
            self._law.start(link.q, link.v)  # the pushes were nothing to learn from
            self._take(k + 1, Trigger.ENABLED, "running")
        elif probe.finding is not Finding.UNDER_WAY:
            self._take(k, Trigger.NOT_ARMED, probe.reason(self._joints[probe.joint]))

    def _await_brakes(self, k: int, elapsed: int) -> None:
        """End when every drive is off and its brake closed, or one does not say so."""
        seconds = elapsed * self._period
        live = self._link.first_live()
        if live < 0 and elapsed > 0 and seconds >= self._brake_s:
            self._take(k, Trigger.OFF, "drives disabled, brakes closed")
        elif live >= 0 and seconds >= OFF_TIMEOUT_S:
            text = f"did not say within {OFF_TIMEOUT_S} s that it is off"
            self._take(k, Trigger.NOT_OFF, f"{self._joints[live]}: {text}", ERROR)

    def _follow(self, k: int, elapsed: int) -> None:
        """Leave the reference when it is over; say when an actuator is lost, and found again."""
        if elapsed + 1 >= self._run_cycles:
            self._take(k, Trigger.DURATION, "duration reached, coming to rest")
            return
        lost = first_loss(self._rec)
        if lost >= 0 and self._state is State.RUN:
            self._take(k, Trigger.LOSS, f"degraded: {self._joints[lost]} has lost torque")
        elif lost < 0 and self._state is State.DEGRADED:
            self._take(k, Trigger.NO_LOSS, "no actuator loss any more")

    def _stop_for(self, k: int, violation: int, joint: int) -> None:
        """Stop for a violation.

        One that can be ramped down stands while the ramp lasts: it is no second one.
        """
        ramp = BY_VIOLATION[violation].ramp
        name = self._joints[joint] if joint >= 0 else ""
        text = self._supervisor.reason(violation, joint, name, self._law_error)
        if self._probing and violation == limits.MOVED:
            text = f"{name}: does not hold its pose: polarity of its drive, or of one before it"
        following = self._state in FOLLOWING
        self._take(k, Trigger.RAMP if ramp else Trigger.QUICK, text)
        if following and violation in _FROM_WHERE_IT_IS:
            # From where the joint is, not from where it should be.
            self._ramp_from[0, joint] = self._rec[signals.Q, joint]
            self._ramp_from[1, joint] = self._rec[signals.V, joint]

    def _take(self, k: int, trigger: Trigger, text: str, severity: int = INFO) -> None:
        """Take the edge of a trigger from the present state: its action, then its target.

        Args:
            k: Cycle at which the target's phase begins.
            trigger: What happened; means nothing where the state has no such edge.
            text: What to say; the reason, for a stop.
            severity: Of the event.
        """
        taken = edge(self._state, trigger)
        if taken is None:
            return
        action = taken.action
        first = trigger in _STOPS and self.outcome.end_state == "done"
        if first:
            operator = trigger is Trigger.OPERATOR
            self.outcome.end_state = "interrupted" if operator else "safe stop"
            self.outcome.reason = text
        if action is Action.KEEP_RAMP:
            if first:
                self._event(k * self._period, ERROR, "controller", f"safe stop: {text}")
            return
        if action is Action.RAMP:
            self._ramp_from[:] = self._desired
            if trigger is not Trigger.DURATION:
                severity, text = ERROR, f"safe stop: {text}"
        elif action is Action.QUICK_STOP:
            self._link.goal = GOAL_STOP
            severity, text = ERROR, f"quick stop: {text}"
        elif action is Action.DISABLE:
            self._link.goal = GOAL_OFF
        elif action is Action.ENABLE:
            self._link.goal = GOAL_OPERATE
        if action is Action.NOTE:
            severity = WARNING if trigger is Trigger.LOSS else INFO
        else:
            self._phase_start = k
        self._state = taken.target
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
