"""The loop under a clock and with drives that the test controls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.config.scenario import (
    ExecutorTable,
    ReferenceTable,
    RobotTable,
    Scenario,
    SupervisorTable,
)
from dftc_rt.control import signals
from dftc_rt.drives.interface import GOAL_OFF, GOAL_OPERATE, GOAL_STOP
from dftc_rt.errors import BusError
from dftc_rt.memory import MemorySink
from dftc_rt.reference import Reference
from dftc_rt.rt.clock import FakeClock, LockstepClock
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


@pytest.fixture
def bench() -> Bench:
    return Bench()


# --- life of a run -----------------------------------------------------------------------


def test_a_run_from_arming_to_closed_brakes(bench: Bench) -> None:
    outcome = bench.run()
    assert (outcome.end_state, outcome.reason) == ("done", "")
    assert bench.states == [ARM, RUN, FINISH, FAULT]
    assert np.count_nonzero(bench.records[:, 4] == RUN) == 20  # duration_s at 1 kHz
    assert np.count_nonzero(bench.records[:, 4] == FINISH) == 10  # stop_ramp_s
    assert bench.texts == [
        "arming", "running", "duration reached, coming to rest", "at rest, disabling the drives",
        "drives disabled, brakes closed",
    ]  # fmt: skip
    assert outcome.counters.cycles == len(bench.records) == len(bench.link.ticks)
    assert outcome.counters.missed == 3
    assert bench.law.started_at is not None
    assert bench.law.started_at.tolist() == [0.1, -0.2]
    # No torque once the drives are to be off; torque in every cycle before.
    goals = [goal for _, _, goal in bench.link.commands]
    torque = [wanted for _, wanted, _ in bench.link.commands]
    assert goals == sorted(goals, key=[GOAL_OPERATE, GOAL_OFF].index)
    assert torque == [goal == GOAL_OPERATE for goal in goals]


def test_drives_are_powered_off_after_the_loop_however_it_ended(bench: Bench) -> None:
    bench.link.enables = False
    bench.unconfirmed = ("elbow",)
    assert bench.run().end_state == "safe stop"
    assert bench.shut_down_after == len(bench.link.ticks)
    assert bench.texts[-1] == "elbow: power off not confirmed"


def test_record_is_laid_out_as_the_schema_says(bench: Bench) -> None:
    bench.law.rho[:] = [0.9, 0.8]
    bench.link.age[:] = [0.0, 2.0]
    bench.run()
    assert bench.records.shape[1] == HEADER + 15 * 2
    assert bench.records[:, 0] == pytest.approx(np.arange(len(bench.records)) * 1e-3)
    for row, expected in {
        signals.Q: [0.1, -0.2],
        signals.QD: [0.1, -0.2],
        signals.TAU_LAW: [2.46, -9.12],
        signals.TAU_CMD: [1.2, -4.6],  # as sent, not as asked for
        signals.RHO_HAT: [0.9, 0.8],
        signals.AGE: [0.0, 2.0],
    }.items():
        assert bench.row(row)[5] == pytest.approx(expected), signals.NAMES[row]


def test_drives_that_are_not_enabled_end_the_run(bench: Bench) -> None:
    bench.link.enables = False
    outcome = bench.run()
    assert outcome.end_state == "safe stop"
    assert outcome.reason == "elbow: the drive was not enabled in 5.0 s"
    assert bench.states == [ARM, FAULT]


def test_drives_that_do_not_confirm_are_not_waited_for_longer(bench: Bench) -> None:
    bench.link.disables = False
    assert bench.run().end_state == "done"
    assert np.count_nonzero(bench.records[:, 4] == FAULT) == pytest.approx(1000, abs=2)


# --- time --------------------------------------------------------------------------------


def test_lateness_does_not_pile_up(bench: Bench) -> None:
    late = [0, 300_000, 0, 400_000, 400_000, 0, 0, 100_000]
    bench.clock.delays = list(late)
    bench.run()
    first = bench.link.ticks[0][1]
    for k, (number, deadline, when) in enumerate(bench.link.ticks):
        assert number == k
        assert deadline == first + k * PERIOD
        assert when == deadline + (late[k] if k < len(late) else 0)
    assert bench.records[: len(late), 1] == pytest.approx([x * 1e-9 for x in late])
    assert not bench.records[len(late) :, 1].any()


def test_times_of_a_cycle_are_told_apart(bench: Bench) -> None:
    bench.link.cost = {6: 250_000}
    update = bench.law.update

    def slow(rec: F64, inertia: F64, bias: F64, load: F64) -> int:
        bench.clock.time += 70_000
        return update(rec, inertia, bias, load)

    bench.law.update = slow  # type: ignore[method-assign]
    bench.run()
    assert bench.records[6, 1:4] == pytest.approx([0.0, 70e-6, 250e-6])
    assert bench.records[7, 1:4] == pytest.approx([0.0, 70e-6, 0.0])


def overrun(policy: str) -> tuple[Bench, Outcome]:
    bench = Bench(executor={"overrun": policy})
    bench.link.cost = {10: 2_500_000}
    return bench, bench.run()


def test_overrun_skip() -> None:
    bench, outcome = overrun("skip")
    assert outcome.end_state == "done"
    assert (outcome.counters.overruns, outcome.counters.skipped) == (1, 1)
    numbers = [number for number, _, _ in bench.link.ticks]
    assert numbers[9:14] == [9, 10, 12, 13, 14]
    assert bench.records[11, 0] == pytest.approx(0.012)
    assert bench.records[11, 1] == pytest.approx(0.0005)  # the grid stays where it was
    assert not bench.records[12:, 1].any()


def test_overrun_catch_up() -> None:
    bench, outcome = overrun("catch_up")
    assert outcome.end_state == "done"
    assert (outcome.counters.overruns, outcome.counters.skipped) == (2, 0)
    assert [number for number, _, _ in bench.link.ticks] == list(range(len(bench.link.ticks)))
    assert bench.records[11:14, 1] == pytest.approx([1.5e-3, 0.5e-3, 0.0])


def test_overrun_stop() -> None:
    bench, outcome = overrun("stop")
    assert outcome.end_state == "safe stop"
    assert "overrun" in outcome.reason
    assert bench.states == [ARM, RUN, STOP, FAULT]
    assert outcome.counters.overruns == 1


def test_lock_step_knows_no_lateness() -> None:
    bench = Bench(clock=LockstepClock())
    outcome = bench.run()
    assert outcome.end_state == "done"
    assert outcome.counters.overruns == 0
    assert not bench.records[:, 1].any()
    assert [number for number, _, _ in bench.link.ticks] == list(range(len(bench.link.ticks)))


# --- safe stops --------------------------------------------------------------------------


def not_a_number(bench: Bench) -> None:
    bench.link.q[1] = np.nan


def drive_fault(bench: Bench) -> None:
    bench.link.status[1] = FAULT_BIT


def stale(bench: Bench) -> None:
    bench.link.age[1] = 20.0


def tracking(bench: Bench) -> None:
    bench.link.q[1] += 0.51


def rho_low(bench: Bench) -> None:
    bench.law.verdict[1], bench.law.rho[1] = signals.ACTUATOR_LOSS, 0.14


def saturated(bench: Bench) -> None:
    bench.law.tau[1] = -100.0


def law_fails(bench: Bench) -> None:
    bench.law.status = 2
    bench.law.failing[1] = True


def drops_out(bench: Bench) -> None:
    bench.link.status[1] = READY


def runs_away(bench: Bench) -> None:
    bench.link.q[1] += 1.01


def bus_fails(bench: Bench) -> None:
    bench.link.fault = "can1: bus-off"


def emergency(bench: Bench) -> None:
    bench.link.emergency[1] = 0x8120


def too_much(bench: Bench) -> None:
    bench.law.tau[1] = -100.1


def law_raises(bench: Bench) -> None:
    def fail(*_: object) -> int:
        raise FloatingPointError("of one's own")

    bench.law.update = fail  # type: ignore[method-assign,assignment]


def overspeed(bench: Bench) -> None:
    bench.link.v[1] = -9.1


def too_fast(bench: Bench) -> None:
    bench.link.v[1] = -4.6


def break_at(bench: Bench, cycle: int, action: Callable[[Bench], None]) -> None:
    bench.link.on_cycle = lambda k: action(bench) if k == cycle else None


@pytest.mark.parametrize(
    ("action", "reason"),
    [
        (not_a_number, "elbow: a value that is not finite"),
        (drive_fault, "elbow: the drive reports a fault"),
        (stale, "elbow: no fresh feedback for 20 cycles"),
        (law_fails, "elbow: a value that is not finite"),
        (drops_out, "elbow: the drive left operation enabled"),
        (runs_away, "elbow: tracking error over 1.0 rad"),
        (rho_low, "elbow: estimated effectiveness below 0.15"),
        (bus_fails, "can1: bus-off"),
        (emergency, "elbow: the drive sent an emergency"),
        (too_much, "elbow: the law asks for more than 100 Nm"),
        (law_raises, "the law raised FloatingPointError: of one's own"),
        (overspeed, "elbow: speed over 9 rad/s"),
    ],
)
def test_where_control_cannot_be_trusted_the_drives_are_quick_stopped(
    bench: Bench, action: Callable[[Bench], None], reason: str
) -> None:
    break_at(bench, 8, action)
    outcome = bench.run()
    assert (outcome.end_state, outcome.reason) == ("safe stop", reason)
    assert bench.states == [ARM, RUN, FAULT]
    assert bench.link.commands[8][1:] == (False, GOAL_STOP)  # in that very cycle
    assert not any(torque for _, torque, _ in bench.link.commands[8:])
    assert f"quick stop: {reason}" in bench.texts


@pytest.mark.parametrize(
    ("action", "reason", "after"),
    [
        (tracking, "elbow: tracking error over 0.5 rad", 0),
        (saturated, "elbow: torque saturated for 0.005 s", 4),
        (too_fast, "elbow: speed over 4.5 rad/s", 0),
    ],
)
def test_otherwise_the_arm_is_brought_to_rest_first(
    bench: Bench, action: Callable[[Bench], None], reason: str, after: int
) -> None:
    break_at(bench, 8, action)  # and it stands: it is no second violation
    outcome = bench.run()
    assert (outcome.end_state, outcome.reason) == ("safe stop", reason)
    assert bench.states == [ARM, RUN, STOP, FAULT]
    assert bench.records[9 + after, 4] == STOP
    assert np.count_nonzero(bench.records[:, 4] == STOP) == 10
    torque = [wanted for _, wanted, _ in bench.link.commands]
    assert torque == [state != FAULT for state in bench.records[1:, 4]] + [False]


def test_after_a_tracking_error_the_ramp_begins_where_the_joint_is(bench: Bench) -> None:
    break_at(bench, 8, tracking)
    bench.run()
    ramp = bench.records[:, 4] == STOP
    np.testing.assert_allclose(bench.row(signals.QD)[ramp], [[0.1, -0.2 + 0.51]] * 10)


def test_a_violation_that_no_ramp_can_mend_ends_the_ramp(bench: Bench) -> None:
    def both(k: int) -> None:
        if k == 8:
            saturated(bench)
        if k == 15:
            drive_fault(bench)

    bench.link.on_cycle = both
    outcome = bench.run()
    assert outcome.reason == "elbow: torque saturated for 0.005 s"
    assert bench.states == [ARM, RUN, STOP, FAULT]
    assert bench.link.commands[15][1:] == (False, GOAL_STOP)


def test_a_drive_fault_is_found_behind_a_lesser_violation(bench: Bench) -> None:
    def both(k: int) -> None:
        if k == 8:
            bench.link.q[0] += 0.51
            drive_fault(bench)

    bench.link.on_cycle = both
    assert bench.run().reason == "elbow: the drive reports a fault"


@pytest.mark.parametrize("error", [FloatingPointError("a law"), BusError("can1", "gone")])
def test_an_exception_in_the_loop_leaves_no_drive_powered(bench: Bench, error: Exception) -> None:
    def fail(k: int) -> None:
        if k == 8:
            raise error

    bench.link.on_cycle = fail
    with pytest.raises(type(error)):
        bench.run()
    assert bench.link.abandoned
    assert bench.shut_down_after == 9


def test_skipped_ticks_are_told_to_the_law() -> None:
    skipping, _ = overrun("skip")
    assert sum(skipping.law.skipped) == skipping.executor.outcome.counters.skipped > 0
    catching, _ = overrun("catch_up")
    assert catching.law.skipped == []


@pytest.mark.parametrize(
    ("action", "just_within"),
    [
        (stale, lambda bench: bench.link.age.__setitem__(1, 19.0)),
        (tracking, lambda bench: bench.link.q.__setitem__(1, -0.2 + 0.49)),
        (rho_low, lambda bench: bench.law.rho.__setitem__(1, 0.05)),  # without the verdict
        (saturated, lambda bench: bench.law.tau.__setitem__(1, 99.9)),
        (too_much, lambda bench: bench.law.tau.__setitem__(1, -99.9)),
        (too_fast, lambda bench: bench.link.v.__setitem__(1, 4.4)),
    ],
)
def test_just_within_the_limits_is_no_stop(
    bench: Bench, action: object, just_within: Callable[[Bench], None]
) -> None:
    break_at(bench, 8, just_within)
    assert bench.run().end_state == "done"


@pytest.mark.parametrize(("position", "code"), [(-2.06, "safe stop"), (-2.04, "done")])
def test_a_joint_beyond_its_limits_is_brought_to_rest(position: float, code: str) -> None:
    bench = Bench(home=(0.1, -1.9))  # the joint may go to -2, and 0.05 more
    bench.link.on_cycle = lambda k: bench.link.q.__setitem__(1, position) if k >= 8 else None
    outcome = bench.run()
    assert outcome.end_state == code
    if code == "safe stop":
        assert outcome.reason == "elbow: position beyond its limits by more than 0.05 rad"
        assert bench.states == [ARM, RUN, STOP, FAULT]
        ramp = bench.records[:, 4] == STOP
        assert np.all(bench.row(signals.QD)[ramp][:, 1] == position)  # from where it is


def test_a_torque_that_goes_to_and_fro_is_stopped_and_one_step_is_not() -> None:
    bench = Bench()
    bench.link.on_cycle = lambda k: bench.law.tau.__setitem__(1, 30.0 if k % 2 else -30.0)
    outcome = bench.run()
    assert bench.states == [ARM, RUN, STOP, FAULT]
    assert outcome.reason == (
        "elbow: torque changed by more than 50 Nm a cycle, 10 cycles in a row"
    )
    step = Bench()
    step.link.on_cycle = lambda k: step.law.tau.__setitem__(1, 60.0 if k % 11 else -60.0)
    assert step.run().end_state == "done"


def test_overruns_in_a_row_bring_the_arm_to_rest() -> None:
    bench = Bench(supervisor={"overruns_in_a_row": 3})
    bench.link.cost = dict.fromkeys(range(6, 200), 1_500_000)
    outcome = bench.run()
    assert outcome.reason == "3 cycles in a row took longer than the period"
    assert bench.states[:3] == [ARM, RUN, STOP]
    assert np.count_nonzero(bench.records[:, 4] == RUN) == 3 + 3 + 1  # seen in the next cycle


def test_now_and_then_an_overrun_is_none_in_a_row() -> None:
    bench = Bench(supervisor={"overruns_in_a_row": 3})
    for k in (6, 8, 14, 16):  # each is followed by a cycle in time
        bench.link.cost[k] = 1_500_000
    outcome = bench.run()
    assert outcome.end_state == "done"
    assert outcome.counters.overruns == 4


def test_a_pose_that_changes_behind_a_closed_brake_is_not_enabled(bench: Bench) -> None:
    bench.link.enables = False
    break_at(bench, 2, lambda b: b.link.q.__setitem__(1, -0.26))
    outcome = bench.run()
    assert outcome.reason == "elbow: moved while its brake was closed"
    assert bench.states == [ARM, FAULT]


@pytest.mark.parametrize(
    ("row", "value"),
    [(row, value) for row in range(len(signals.NAMES)) for value in (np.nan, np.inf)],
)
def test_what_is_not_finite_anywhere_stops_the_run(row: int, value: float) -> None:
    none_is_allowed = row in (signals.RHO_HAT, signals.RHO_STD, signals.RESIDUAL)
    bench = Bench()
    update = bench.law.update

    def broken(rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        status = update(rec, inertia, bias, load)
        if len(bench.link.ticks) > 8:
            rec[row, 0] = value
        return status

    bench.law.update = broken  # type: ignore[method-assign]
    outcome = bench.run()
    if (none_is_allowed and np.isnan(value)) or row == signals.RHO_STD:
        assert outcome.end_state == "done"
    else:
        assert outcome.reason == "shoulder: a value that is not finite"
        assert bench.states == [ARM, RUN, FAULT]


def test_a_lost_actuator_is_degraded_operation_and_the_motion_goes_on(bench: Bench) -> None:
    def lose_and_find(k: int) -> None:
        bench.law.verdict[1] = signals.ACTUATOR_LOSS if 8 <= k < 14 else signals.HEALTHY
        bench.law.rho[1] = 0.6

    bench.link.on_cycle = lose_and_find
    assert bench.run().end_state == "done"
    assert bench.states == [ARM, RUN, DEGRADED, RUN, FINISH, FAULT]
    assert np.count_nonzero(bench.records[:, 4] == DEGRADED) == 6
    following = np.isin(bench.records[:, 4], (RUN, DEGRADED))
    assert np.count_nonzero(following) == 20  # duration_s goes on through it
    assert bench.texts[2:4] == ["degraded: elbow has lost torque", "no actuator loss any more"]


def test_every_violation_of_a_degraded_run_stops_it_too(bench: Bench) -> None:
    def lose_then(k: int) -> None:
        if k >= 8:
            bench.law.verdict[1], bench.law.rho[1] = signals.ACTUATOR_LOSS, 0.6
        if k == 12:
            tracking(bench)
        if k == 15:
            drive_fault(bench)

    bench.link.on_cycle = lose_then
    bench.run()
    assert bench.states == [ARM, RUN, DEGRADED, STOP, FAULT]


def test_drives_get_time_for_their_brakes(bench: Bench) -> None:
    break_at(bench, 8, drive_fault)
    bench.run()
    assert np.count_nonzero(bench.records[:, 4] == FAULT) == 4  # brake_s


def test_saturation_counts_only_without_a_break(bench: Bench) -> None:
    def now_and_then(k: int) -> None:
        bench.law.tau[1] = 0.0 if k % 5 == 0 else -100.0  # saturation_s is five cycles

    bench.link.on_cycle = now_and_then
    assert bench.run().end_state == "done"


def test_first_reason_is_the_one_that_is_told(bench: Bench) -> None:
    def both(k: int) -> None:
        if k == 8:
            rho_low(bench)
        if k == 9:
            drive_fault(bench)

    bench.link.on_cycle = both
    assert bench.run().reason == "elbow: estimated effectiveness below 0.15"


# --- the operator --------------------------------------------------------------------------


def test_stop_while_arming(bench: Bench) -> None:
    bench.stop_at = 0
    bench.link.enables = False
    outcome = bench.run()
    assert outcome.end_state == "interrupted"
    assert outcome.reason == "stop requested by the operator"
    assert bench.states == [ARM, FAULT]
    assert bench.link.commands[-1][1:] == (False, GOAL_STOP)


def test_stop_while_running(bench: Bench) -> None:
    bench.stop_at = 10
    outcome = bench.run()
    assert outcome.end_state == "interrupted"
    assert outcome.reason == "stop requested by the operator"
    assert bench.states == [ARM, RUN, STOP, FAULT]
    assert np.count_nonzero(bench.records[:, 4] == STOP) == 10


def test_stop_while_coming_to_rest_is_told(bench: Bench) -> None:
    bench.stop_at = 26
    outcome = bench.run()
    assert (outcome.end_state, outcome.reason) == ("interrupted", "stop requested by the operator")
    assert bench.states == [ARM, RUN, FINISH, FAULT]
    assert bench.texts.count("safe stop: stop requested by the operator") == 1


# --- the recorder ----------------------------------------------------------------------------


def test_dropped_records_are_told_once(bench: Bench) -> None:
    bench.sink.commit = lambda: False  # type: ignore[method-assign]
    assert bench.run().end_state == "done"
    assert bench.texts.count("the recorder does not keep up") == 1
