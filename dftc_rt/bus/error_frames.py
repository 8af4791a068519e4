"""Error frames: what a CAN interface tells its own machine about its side of the bus.

They never travel on the wire. SocketCAN hands them to a socket that asks for them
(``CAN_RAW_ERR_FILTER``) as classical frames whose identifier holds the error classes.
Which of them come depends on the driver; single bus errors (no acknowledgement, stuffing,
CRC) as a rule only with ``berr-reporting on``.

Source: Linux ``include/uapi/linux/can/error.h``.
"""

from __future__ import annotations

from typing import Final, Literal

from dftc_rt.bus.frame import ERR_FLAG, pack

ALL_CLASSES: Final = 0x1FFF_FFFF
"""Every class, as ``CAN_RAW_ERR_FILTER`` takes it."""

TX_TIMEOUT: Final = 0x001
LOST_ARBITRATION: Final = 0x002
CONTROLLER: Final = 0x004  # data[1] says what
PROTOCOL: Final = 0x008  # data[2] says what, data[3] where in the frame
TRANSCEIVER: Final = 0x010
NO_ACKNOWLEDGEMENT: Final = 0x020
BUS_OFF: Final = 0x040
BUS_ERROR: Final = 0x080
RESTARTED: Final = 0x100
COUNTERS: Final = 0x200  # data[6] and data[7] hold the error counters

# data[1] of a frame of class CONTROLLER.
RX_OVERFLOW: Final = 0x01
TX_OVERFLOW: Final = 0x02
WARNING: Final = 0x04 | 0x08
PASSIVE: Final = 0x10 | 0x20
ACTIVE: Final = 0x40

ErrorState = Literal["active", "warning", "passive", "bus-off"]

_COUNTED: Final = (
    (TX_TIMEOUT, "transmit timeout"),
    (LOST_ARBITRATION, "lost arbitration"),
    (PROTOCOL, "protocol error"),
    (TRANSCEIVER, "transceiver error"),
    (NO_ACKNOWLEDGEMENT, "no acknowledgement"),
    (BUS_ERROR, "bus error"),
)
_STATES: Final[dict[ErrorState, str]] = {
    "active": "error active again",
    "warning": "over 95 errors",
    "passive": "error passive",
    "bus-off": "bus-off",
}


def state_frame(state: ErrorState, tec: int = 0, rec: int = 0) -> bytes:
    """Return the error frame by which a driver tells a new state.

    Args:
        state: The state.
        tec: Transmit error counter; told up to 255.
        rec: Receive error counter.
    """
    if state == "bus-off":
        return pack(ERR_FLAG | BUS_OFF, bytes(8))
    detail = {"active": ACTIVE, "warning": WARNING, "passive": PASSIVE}[state]
    data = bytes([0, detail, 0, 0, 0, 0, min(tec, 255), min(rec, 255)])
    return pack(ERR_FLAG | CONTROLLER | COUNTERS, data)


def restart_frame() -> bytes:
    """Return the error frame by which a driver tells that it is back from bus-off."""
    return pack(ERR_FLAG | RESTARTED, bytes(8))


class ErrorCounts:
    """What one interface has told about its errors.

    Attributes:
        state: Of its CAN controller, as far as error frames have said so.
        counts: Error frames by what they say, in the order of their first.
        frames: Error frames altogether.
        tec: Its transmit error counter when it was last told.
        rec: Its receive error counter when it was last told.
    """

    def __init__(self) -> None:
        """Begin error active, with nothing counted."""
        self.state: ErrorState = "active"
        self.counts: dict[str, int] = {}
        self.frames = 0
        self.tec = 0
        self.rec = 0

    def take(self, can_id: int, data: bytes) -> tuple[str, ...]:
        """Count an error frame; return what of it is worth telling.

        That is every change of state, and of each kind of error the first, the tenth, the
        hundredth and so on: a bus in trouble sends thousands a second.

        Args:
            can_id: Identifier with flags; ``ERR_FLAG`` is set.
            data: Its data, 8 bytes.
        """
        self.frames += 1
        told: list[str] = []
        classes, detail = can_id & ~ERR_FLAG, data.ljust(8, b"\0")
        if classes & (COUNTERS | CONTROLLER):  # before COUNTERS was there they came with states
            self.tec, self.rec = detail[6], detail[7]
        for mask, name in _COUNTED:
            if classes & mask:
                told += self._count(name)
        if classes & CONTROLLER:
            if detail[1] & RX_OVERFLOW:
                told += self._count("receive overflow")
            if detail[1] & TX_OVERFLOW:
                told += self._count("transmit overflow")
        if (state := self._state(classes, detail[1])) != self.state:
            self.state = state
            told.append(_STATES[state] + self._counters())
        if classes & RESTARTED:
            told += self._count("restart")
        return tuple(told)

    def summary(self) -> str:
        """Return the counts as words, "" when there are none."""
        return ", ".join(f"{count} {name}" for name, count in self.counts.items())

    def _count(self, name: str) -> list[str]:
        count = self.counts[name] = self.counts.get(name, 0) + 1
        if str(count).strip("0") != "1":
            return []
        return [name if count == 1 else f"{name} ({count} so far)"]

    def _state(self, classes: int, detail: int) -> ErrorState:
        if classes & BUS_OFF:
            return "bus-off"
        if classes & RESTARTED:
            return "active"
        if classes & CONTROLLER:
            if detail & PASSIVE:
                return "passive"
            if detail & WARNING:
                return "warning"
            if detail & ACTIVE:
                return "active"
        return self.state

    def _counters(self) -> str:
        if not self.tec and not self.rec:
            return ""
        return f" (errors as sender {self.tec}, as receiver {self.rec})"


def bus_off_remedy(interface: str) -> str:
    """Return what to do about an interface that took itself off its bus."""
    return (
        f"bus-off, {interface} took itself off the bus after too many errors; "
        f"check wiring, termination and bit rate; ip link set {interface} type can restart-ms 100 "
        "lets it come back"
    )
