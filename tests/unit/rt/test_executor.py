"""The life of a run, its time, its operator."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.control import signals
from dftc_rt.drives.interface import GOAL_OFF, GOAL_OPERATE, GOAL_STOP
from dftc_rt.rt.clock import LockstepClock
from dftc_rt.rt.executor import Outcome
from tests.unit.rt.bench import (
    ARM,
    F64,
    FAULT,
    FINISH,
    HEADER,
    PERIOD,
    RUN,
    STOP,
    Bench,
)

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


def test_skipped_ticks_are_told_to_the_law() -> None:
    skipping, _ = overrun("skip")
    assert sum(skipping.law.skipped) == skipping.executor.outcome.counters.skipped > 0
    catching, _ = overrun("catch_up")
    assert catching.law.skipped == []


def test_lock_step_knows_no_lateness() -> None:
    bench = Bench(clock=LockstepClock())
    outcome = bench.run()
    assert outcome.end_state == "done"
    assert outcome.counters.overruns == 0
    assert not bench.records[:, 1].any()
    assert [number for number, _, _ in bench.link.ticks] == list(range(len(bench.link.ticks)))


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
