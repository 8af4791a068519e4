"""What the controller's process leaves in the log when it ends."""

from __future__ import annotations

from typing import Any

import pytest

from dftc_rt.cli.processes import roles
from dftc_rt.cli.processes.child import Flags
from dftc_rt.cli.processes.roles import Rings
from dftc_rt.cli.session import open_session
from dftc_rt.errors import BusError
from dftc_rt.log.ending import ending_of
from dftc_rt.rt.executor import Counters, Outcome


class Executor:
    """One whose bus goes away."""

    t = 1.5

    def __init__(self, *_: Any) -> None:
        self.outcome = Outcome(counters=Counters(cycles=1500, overruns=2))

    def run(self) -> Outcome:
        raise BusError("can1", "is down")


def test_a_lost_bus_is_the_reason_in_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(roles, "connect", Executor)
    monkeypatch.setattr(roles, "on_sigterm", lambda action: None)
    opened = open_session("ur5_elbow_loss")
    rings = Rings.create(opened)
    report = roles.controller(opened, lambda: [], rings, Flags(), lockstep=True)
    assert report["outcome"]["reason"] == "bus lost: can1: is down"
    events = rings.events[0].drain()
    assert (events[0].t, events[0].severity) == (1.5, 3)
    assert events[0].text == "safe stop: bus lost: can1: is down"
    ending = ending_of(events)
    assert ending is not None
    assert (ending.end_state, ending.reason) == ("safe stop", "bus lost: can1: is down")
    assert (ending.cycles, ending.overruns) == (1500, 2)
    assert rings.events[0].closed
