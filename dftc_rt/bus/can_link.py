"""How a CAN interface is set up, as its driver tells over rtnetlink.

Source: Linux ``include/uapi/linux/can/netlink.h``; ``ip -details link show can0`` prints the same.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from dftc_rt.bus.rtnetlink import routing_attributes

_BITTIMING: Final = 1
_STATE: Final = 4
_CTRLMODE: Final = 5
_RESTART_MS: Final = 6
_BERR_COUNTER: Final = 8
_DATA_BITTIMING: Final = 9

_STATES: Final = (
    "error active", "error warning", "error passive", "bus-off", "stopped", "sleeping",
)  # fmt: skip
_MODES: Final = {
    0x01: "loopback",
    0x02: "listen-only",
    0x08: "one-shot",
    0x10: "berr-reporting",
    0x20: "fd",
    0x40: "presume-ack",
}
_U32: Final = struct.Struct("=I")
_BITTIMING_STRUCT: Final = struct.Struct("=8I")  # bitrate, sample point in 0.1 %, tq in ns, …
_MODE_STRUCT: Final = struct.Struct("=II")  # mask, flags
_COUNTER_STRUCT: Final = struct.Struct("=HH")


@dataclass(frozen=True, slots=True)
class CanLink:
    """What a CAN driver tells of its interface; a vcan link tells nothing.

    Attributes:
        bitrate: Bits per second; 0: not told.
        sample_point: Share of a bit at which it is sampled; 0: not told.
        data_bitrate: Of the data part of CAN FD frames; 0: not told.
        state: ``error active``, ``error warning``, ``error passive``, ``bus-off``, ``stopped``,
            ``sleeping``; "" when it is not told.
        modes: Of ``ip link set … type can``, those that are on.
        restart_ms: Time after which it comes back from bus-off by itself; 0: it does not;
            None: not told.
        tec: Transmit error counter; None: not told.
        rec: Receive error counter; None: not told.
    """

    bitrate: int = 0
    sample_point: float = 0.0
    data_bitrate: int = 0
    state: str = ""
    modes: tuple[str, ...] = ()
    restart_ms: int | None = None
    tec: int | None = None
    rec: int | None = None


def decode_can_link(data: bytes) -> CanLink:
    """Return what the driver's part of an answer about a link says (``Link.data``)."""
    found = dict(routing_attributes(data))
    bitrate, sample_point = _bit_timing(found.get(_BITTIMING, b""))
    state = _number(found.get(_STATE, b""))
    flags = _MODE_STRUCT.unpack_from(found[_CTRLMODE])[1] if _CTRLMODE in found else 0
    errors = _COUNTER_STRUCT.unpack_from(found[_BERR_COUNTER]) if _BERR_COUNTER in found else None
    return CanLink(
        bitrate=bitrate,
        sample_point=sample_point,
        data_bitrate=_bit_timing(found.get(_DATA_BITTIMING, b""))[0],
        state=_STATES[state] if state is not None and state < len(_STATES) else "",
        modes=tuple(name for mask, name in _MODES.items() if flags & mask),
        restart_ms=_number(found.get(_RESTART_MS, b"")),
        tec=None if errors is None else errors[0],
        rec=None if errors is None else errors[1],
    )


def _bit_timing(value: bytes) -> tuple[int, float]:
    if len(value) < _BITTIMING_STRUCT.size:
        return 0, 0.0
    bitrate, sample_point = _BITTIMING_STRUCT.unpack_from(value)[:2]
    return bitrate, sample_point / 1000.0


def _number(value: bytes) -> int | None:
    return _U32.unpack_from(value)[0] if len(value) >= _U32.size else None
