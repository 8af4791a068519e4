"""What ends a run before its time, and how the arm comes to rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dftc_rt.control import signals
from dftc_rt.drives.interface import GOAL_STOP
from dftc_rt.errors import BusError
from tests.unit.rt.bench import (
    ARM,
    DEGRADED,
    F64,
    FAULT,
    FAULT_BIT,
    FINISH,
    READY,
    RUN,
    STOP,
    Bench,
)


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
