"""Fault confinement: what a CAN controller makes of the errors that it sees.

Every node counts errors as sender (TEC) and as receiver (REC). Over 127 it is error passive, with
a TEC over 255 it leaves the bus.

Simplified: a receiver's count goes up by 1 for a corrupted frame whoever's flag came first, and
overload frames do not exist.

Source: ISO 11898-1:2015, 12.1.4 "Fault confinement".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

State = Literal["active", "passive", "bus-off"]

PASSIVE: Final = 127  # errors beyond which a node is passive
BUS_OFF: Final = 255  # errors as sender beyond which it is off
_SENDER_ERROR: Final = 8
_REC_AFTER_PASSIVE: Final = 119


@dataclass(slots=True)
class ErrorCounters:
    """Counters of one node.

    Attributes:
        tec: Errors as sender.
        rec: Errors as receiver.
    """

    tec: int = 0
    rec: int = 0

    @property
    def state(self) -> State:
        """What the counters make of the node."""
        if self.tec > BUS_OFF:
            return "bus-off"
        return "passive" if max(self.tec, self.rec) > PASSIVE else "active"

    def sent(self) -> None:
        """A frame of its own went through."""
        self.tec = max(self.tec - 1, 0)

    def failed(self) -> None:
        """A frame of its own was corrupted."""
        self.tec += _SENDER_ERROR

    def received(self) -> None:
        """A frame of another node came."""
        self.rec = _REC_AFTER_PASSIVE if self.rec > PASSIVE else max(self.rec - 1, 0)

    def spoilt(self) -> None:
        """A frame of another node was corrupted."""
        self.rec = min(self.rec + 1, PASSIVE + 1)

    def restart(self) -> None:
        """Come back from bus-off."""
        self.tec = self.rec = 0
