"""docs/safety.md shows the supervisor's own tables, row by row, and names tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

from dftc_rt.rt.limits import LIMITS
from dftc_rt.rt.supervisor import EDGES, Action, State, Trigger, edge

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
OPERATING = (State.ARM, State.RUN, State.DEGRADED, State.SAFE_STOP, State.FINISH)


def rows(heading: str) -> list[str]:
    """Return the rows of the table below a heading."""
    found = re.search(rf"^## {heading}\n.*?^\|[-| ]+\|\n(.*?)\n(?!\|)", PAGE, re.M | re.S)
    assert found, heading
    return found[1].splitlines()


def name(state: State) -> str:
    return state.name.lower().replace("_", " ")


def test_every_edge_is_in_the_page_as_it_is_in_the_program() -> None:
    assert rows("States") == [
        f"| {name(e.source)} | {e.trigger} | {e.deadline} | {e.action} | {name(e.target)} |"
        for e in EDGES
    ]


def test_every_limit_is_in_the_page_as_it_is_in_the_program() -> None:
    assert rows("Limits") == [
        f"| {limit.condition} | {'ramp' if limit.ramp else 'quick stop'} "
        f"| {limit.reason.replace('{limit}', '…')} |"
        for limit in LIMITS
    ]


def test_a_stop_is_legal_from_every_state_in_which_a_drive_may_be_powered() -> None:
    down = {State.SAFE_STOP, State.FINISH, State.FAULT}
    for state in OPERATING:
        for trigger in (Trigger.QUICK, Trigger.RAMP, Trigger.OPERATOR):
            taken = edge(state, trigger)
            assert taken is not None, (state, trigger)
            assert taken.target in down
    for state in State:
        if state is not State.IDLE:
            gone = edge(state, Trigger.GONE)
            assert gone is not None
            assert (gone.target, gone.action) == (State.IDLE, Action.LAST_WORD)


def test_no_trigger_leads_two_ways_and_every_state_can_be_left_and_reached() -> None:
    assert len({(e.source, e.trigger) for e in EDGES}) == len(EDGES)
    assert {e.source for e in EDGES} == set(State) == {e.target for e in EDGES}


def test_the_tests_that_the_page_names_are_there() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", PAGE)
    assert len(named) > 10
    for path, test in named:
        text = (ROOT / path).read_text(encoding="utf-8")
        assert not test or f"def {test}(" in text, f"{path}::{test}"
