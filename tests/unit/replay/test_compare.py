"""Differences between a log and its replay, both made by hand."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from dftc_rt.control.signals import NAMES
from dftc_rt.log.ending import ending_text
from dftc_rt.log.run import Run, split
from dftc_rt.log.schema import cycle_layout
from dftc_rt.replay.compare import SIGNALS, Difference, compare
from dftc_rt.replay.loop import MEASURED, Replayed
from dftc_rt.ring import Event
from dftc_rt.rt.executor import Outcome

LAYOUT = cycle_layout(("a", "b"), NAMES)
COUNT = 50


def pair(ended: bool = False, ending: str = "", cycles: int = COUNT) -> tuple[Run, Replayed]:
    """A log and a replay that is equal to it, in memory of its own."""
    records = np.random.default_rng(3).standard_normal((COUNT, LAYOUT.size))
    records[:, 0] = np.arange(COUNT) / 100
    records[:, 4] = 3.0
    records[:, LAYOUT.fields.index("rho_std_a")] = math.nan
    counts = dict.fromkeys(("overruns", "skipped", "missed", "refused"), 0) | {"cycles": COUNT}
    state, _, reason = ending.partition(": ")
    events = [Event(0.5, 1, "controller", ending_text(state, reason, counts))] if ending else []
    run = Run.from_records(LAYOUT, records, events=events)
    mine = split(LAYOUT, records[:cycles].copy())
    return run, Replayed(mine, (), Outcome(), ended, False)


def test_everything_but_what_a_clock_measured_is_compared() -> None:
    assert sorted((*SIGNALS, *MEASURED)) == sorted((*LAYOUT.header, *LAYOUT.rows))


def test_equal_to_the_last_bit() -> None:
    run, replayed = pair()
    found = compare(run, replayed)
    assert found.first is None
    assert found.spreads == ()
    assert (found.cycles, found.logged) == (COUNT, COUNT)


def test_the_first_difference_is_the_earliest_and_of_those_the_cause() -> None:
    run, replayed = pair()
    replayed.cycle["tau_cmd"][30, 0] += 1.0
    replayed.cycle["tau_cmd"][20, 1] = 7.0
    replayed.cycle["rho_hat"][20, 1] = np.nextafter(run.cycle["rho_hat"][20, 1], 9.0)
    found = compare(run, replayed)
    logged, mine = run.cycle["rho_hat"][20, 1], replayed.cycle["rho_hat"][20, 1]
    assert found.first == Difference(20, 0.2, "b", "rho_hat", logged, mine)
    assert logged != mine
    rho, command = found.spreads
    assert (rho.signal, rho.cycles, rho.joint, rho.t) == ("rho_hat", 1, "b", 0.2)
    assert (command.signal, command.cycles) == ("tau_cmd", 2)
    largest = abs(7.0 - run.cycle["tau_cmd"][20, 1])
    assert command.largest == pytest.approx(max(1.0, largest))


def test_a_sign_of_zero_differs_and_no_number_equals_no_number() -> None:
    run, replayed = pair()
    run.cycle["s"][4, 0], replayed.cycle["s"][4, 0] = 0.0, -0.0
    replayed.cycle["residual"][5, 0] = math.nan
    found = compare(run, replayed)
    assert found.first is not None
    assert (found.first.cycle, found.first.signal) == (4, "s")
    assert [each.signal for each in found.spreads] == ["residual", "s"]
    assert math.isnan(found.spreads[0].largest)
    assert found.builtins()["spreads"][0]["largest"] is None


def test_states_are_told_by_name() -> None:
    run, replayed = pair()
    replayed.cycle["state"][9] = 5.0
    found = compare(run, replayed)
    assert found.first == Difference(9, 0.09, "", "state", "run", "safe stop")


@pytest.mark.parametrize(
    ("ending", "ended", "reason", "cycles", "expected"),
    [
        ("done", True, "", COUNT, None),
        ("", False, "", COUNT, None),  # cut off: it does not say
        ("safe stop: bus lost: can0: gone", False, "", COUNT, None),
        ("safe stop: a: too far", True, "a: too far", COUNT, None),
        ("safe stop: a: too far", True, "b: too far", COUNT, ("safe stop a: too far",
                                                              "safe stop b: too far")),
        ("done", False, "", COUNT, ("done", "goes on")),
        ("done", True, "", COUNT - 5, ("goes on", "done")),
    ],
)  # fmt: skip
def test_the_end_counts_too(
    ending: str, ended: bool, reason: str, cycles: int, expected: tuple[str, str] | None
) -> None:
    run, replayed = pair(ended, ending, cycles)
    state = "safe stop" if reason else "done"
    found = compare(run, dataclasses.replace(replayed, outcome=Outcome(state, reason))).first
    if expected is None:
        assert found is None
    else:
        assert found is not None
        assert (found.signal, found.logged, found.replayed) == ("end", *expected)
