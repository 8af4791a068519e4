"""The controller's last event: how the run ended, and what its executor counted.

The counts cannot all be had from the records. Whether a tick came while the cycle before
it was still at work is known only after that cycle's record has been handed over, so that
sums of its durations miss the overruns that the handing over made.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from dftc_rt.ring import Event

SOURCE: Final = "controller"
_COUNTS: Final = ("cycles", "overruns", "skipped", "missed", "refused")
_TEXT: Final = re.compile(
    r"ended: (?P<end_state>[a-z ]+); "
    + ", ".join(rf"(?P<{name}>\d+) {name}" for name in _COUNTS)
    + "(?:; (?P<reason>.*))?",
    re.DOTALL,
)


@dataclass(frozen=True)
class Ending:
    """How a run ended.

    Attributes:
        end_state: ``done``, ``interrupted`` or ``safe stop``.
        reason: One line; empty when done.
        cycles: Cycles run.
        overruns: Ticks that came while the previous cycle was still at work.
    """

    end_state: str
    reason: str
    cycles: int
    overruns: int


def ending_text(end_state: str, reason: str, counts: Mapping[str, int]) -> str:
    """The event's text; the reason comes last, because a long text is cut at its end.

    Args:
        end_state: As :class:`Ending` has it.
        reason: One line, or empty.
        counts: Cycles, overruns, skipped, missed, refused, as the executor counted them.
    """
    told = ", ".join(f"{counts[name]} {name}" for name in _COUNTS)
    return f"ended: {end_state}; {told}" + (f"; {reason}" if reason else "")


def ending_of(events: Iterable[Event]) -> Ending | None:
    """How the run ended; None when its controller was cut off before it could say so."""
    found = None
    for event in events:
        match = _TEXT.fullmatch(event.text) if event.source == SOURCE else None
        if match is not None:
            found = Ending(
                match["end_state"],
                match["reason"] or "",
                int(match["cycles"]),
                int(match["overruns"]),
            )
    return found
