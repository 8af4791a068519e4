"""How a run ended is told in an event, and read from it again."""

from __future__ import annotations

import pytest

from dftc_rt.log.ending import Ending, ending_of, ending_text
from dftc_rt.ring import Event, EventRing

COUNTS = {"cycles": 20300, "overruns": 30, "skipped": 12, "missed": 5, "refused": 0}


@pytest.mark.parametrize(
    ("end_state", "reason", "text"),
    [
        ("done", "", "ended: done; 20300 cycles, 30 overruns, 12 skipped, 5 missed, 0 refused"),
        ("safe stop", "a: late; b: too",
         "ended: safe stop; 20300 cycles, 30 overruns, 12 skipped, 5 missed, 0 refused; "
         "a: late; b: too"),
    ],
)  # fmt: skip
def test_there_and_back(end_state: str, reason: str, text: str) -> None:
    assert ending_text(end_state, reason, COUNTS) == text
    events = [Event(0.0, 1, "controller", "running"), Event(9.0, 1, "controller", text)]
    assert ending_of(events) == Ending(end_state, reason, 20300, 30)


def test_only_the_controller_knows() -> None:
    text = ending_text("done", "", COUNTS)
    assert ending_of([Event(9.0, 1, "rig", text)]) is None
    assert ending_of([Event(9.0, 1, "controller", "ended: done; 1 cycles")]) is None
    assert ending_of([]) is None


def test_a_reason_too_long_for_a_ring_leaves_the_counts() -> None:
    ring = EventRing.create("test")
    ring.write(9.0, 1, "controller", ending_text("safe stop", "x" * 2000, COUNTS))
    found = ending_of(ring.drain())
    assert found is not None
    assert (found.cycles, found.overruns, set(found.reason)) == (20300, 30, {"x"})
