"""What came to a run from outside of its records, as the events of its log tell it.

``/cycle`` holds what the drives answered. That the operator asked for a stop, that a bus was
lost, and that a drive sent an emergency while its statusword was still that of a healthy one is
in the events alone: in the reason of the stop that followed in the same cycle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from dftc_rt.log.ending import SOURCE
from dftc_rt.ring import Event
from dftc_rt.rt.limits import BY_VIOLATION, EMERGENCY

_OPERATOR: Final = "stop: stop requested by the operator"
_QUICK: Final = "quick stop: "
_LOST: Final = "bus lost: "


@dataclass(frozen=True)
class Causes:
    """What came from outside, by the number of the cycle in which it was met.

    Attributes:
        stops: Cycles in which the operator's stop was taken.
        faults: What was wrong with a bus.
        emergencies: Index of the joint whose drive sent one.
    """

    stops: frozenset[int]
    faults: dict[int, str]
    emergencies: dict[int, int]


def causes(
    events: Iterable[Event], rate_hz: float, joints: Sequence[str], buses: Sequence[str]
) -> Causes:
    """Find them in the events of a log.

    Args:
        events: Of the log.
        rate_hz: Control rate, Hz.
        joints: Names, in order.
        buses: Names of the buses: what is wrong with one begins with it.
    """
    emergency = BY_VIOLATION[EMERGENCY].reason
    by_text = {f"{joint}: {emergency}": i for i, joint in enumerate(joints)}
    of_a_bus = (_LOST, *(f"{bus}: " for bus in buses))
    stops: set[int] = set()
    faults: dict[int, str] = {}
    emergencies: dict[int, int] = {}
    for each in events:
        if each.source != SOURCE:
            continue
        cycle = round(each.t * rate_hz)
        if each.text.endswith(_OPERATOR):
            stops.add(cycle)
        elif each.text.startswith(_QUICK):
            reason = each.text.removeprefix(_QUICK)
            if reason in by_text:
                emergencies[cycle] = by_text[reason]
            elif reason.startswith(of_a_bus):
                faults[cycle] = reason
    return Causes(frozenset(stops), faults, emergencies)
