"""What came from outside, found again in the events of a log."""

from __future__ import annotations

from dftc_rt.replay.causes import causes
from dftc_rt.ring import Event

ERROR = 3


def found(*texts: tuple[float, str], source: str = "controller") -> object:
    events = [Event(t, ERROR, source, text) for t, text in texts]
    return causes(events, 1000.0, ("can0", "elbow"), ("can1", "can2"))


def test_stops_faults_and_emergencies_by_cycle() -> None:
    outside = causes(
        [
            Event(0.5, ERROR, "controller", "safe stop: stop requested by the operator"),
            Event(0.6, ERROR, "controller", "quick stop: can2: bus-off; restart it"),
            Event(0.7, ERROR, "controller", "quick stop: bus lost: can1: it has gone away"),
            Event(0.8, ERROR, "controller", "quick stop: elbow: the drive sent an emergency"),
            Event(0.9, ERROR, "controller", "quick stop: stop requested by the operator"),
        ],
        1000.0,
        ("shoulder", "elbow"),
        ("can1", "can2"),
    )
    assert outside.stops == {500, 900}
    assert outside.faults == {
        600: "can2: bus-off; restart it",
        700: "bus lost: can1: it has gone away",
    }
    assert outside.emergencies == {800: 1}


def test_what_the_records_hold_is_no_cause() -> None:
    """A joint may have the name that another robot's bus has."""
    nothing = found()
    assert found((0.5, "quick stop: can0: tracking error over 1 rad")) == nothing
    assert found((0.5, "quick stop: elbow: the drive reports a fault")) == nothing
    assert found((0.5, "safe stop: can1: tracking error over 1 rad")) == nothing


def test_what_others_say_is_no_cause() -> None:
    assert found((0.5, "quick stop: can1: bus-off"), source="can1") == found()
