"""Acceptance filters as SocketCAN has them, for the buses that are not the kernel's.

A filter is an identifier and a mask, flags included: a frame matches where ``received & mask ==
identifier & mask``. EFF_FLAG and RTR_FLAG are bits like the others: in the mask, they tell 29-bit
identifiers and remote frames apart. INV_FILTER in the identifier inverts the filter. A frame comes
through when any filter of the socket takes it; with an empty set none does. ERR_FLAG in the mask,
which asks the kernel for error frames, is left out of account: no socket of ours receives any.

A node hands its set to the user-space bus in records of ``FILTER_ID``, which is no frame: one a
filter (identifier and mask as data), then one without data, with which the set is in force.

Source: Linux ``include/uapi/linux/can.h`` (struct can_filter), ``net/can/af_can.c``
(find_rcv_list), ``Documentation/networking/can.rst``, 4.1.1.
"""

from __future__ import annotations

import time
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.fields import can_id
from dftc_rt.bus.frame import EFF_FLAG, ERR_FLAG, RTR_FLAG, SFF_MASK, Frames, frame_buffer, pack
from dftc_rt.bus.interface import Filters, FrameSocket
from dftc_rt.errors import BusError, InputError

INV_FILTER: Final = 0x2000_0000
"""In the identifier: take what does not match."""
FILTER_ID: Final = ERR_FLAG | 0x1FFF_FFFD
"""Of the records that carry a set: an error frame, which no client may send."""
MOST_FILTERS: Final = 512
"""That a socket takes, as in the kernel (CAN_RAW_FILTER_MAX)."""
EVERYTHING: Final = ((0, 0),)

_PATIENCE_S: Final = 1.0
_RETRY_S: Final = 1e-3


def check_filters(filters: Filters | None) -> Filters:
    """Return a set of filters; None stands for one that takes every frame.

    Raises:
        InputError: There are too many.
    """
    chosen = EVERYTHING if filters is None else filters
    if len(chosen) > MOST_FILTERS:
        raise InputError("filters", f"{len(chosen)} filters", f"at most {MOST_FILTERS}")
    return chosen


def send_filters(socket: FrameSocket, filters: Filters | None) -> None:
    """Hand a set to the user-space bus, in the stream of what the node sends. For set-up.

    Args:
        socket: The node.
        filters: The set; None takes every frame.

    Raises:
        InputError: There are too many.
        BusError: The bus has gone away, or does not read what is sent to it.
    """
    chosen = check_filters(filters)
    rows = frame_buffer(len(chosen) + 1)
    for row, (identifier, mask) in zip(rows, chosen, strict=False):
        data = identifier.to_bytes(4, "little") + mask.to_bytes(4, "little")
        row[:] = np.frombuffer(pack(FILTER_ID, data), dtype=np.uint8)
    rows[-1] = np.frombuffer(pack(FILTER_ID, b""), dtype=np.uint8)
    deadline = time.monotonic() + _PATIENCE_S
    while len(rows):
        rows = rows[socket.send(rows, len(rows)) :].copy()
        if len(rows) and time.monotonic() >= deadline:
            raise BusError(socket.name, "the bus does not take the filters")
        if len(rows):
            time.sleep(_RETRY_S)


def compile_filters(filters: Filters) -> NDArray[np.int64] | None:
    """Return a set as rows (identifier, mask, inverted), (n, 3); None: every frame comes through.

    Args:
        filters: The set.
    """
    table = []
    for identifier, mask in filters:
        mask &= ~ERR_FLAG
        if mask & EFF_FLAG and not identifier & EFF_FLAG:
            mask &= SFF_MASK | EFF_FLAG | RTR_FLAG  # as the kernel does
        inverted = bool(identifier & INV_FILTER)
        if not mask and not inverted:
            return None
        table.append((identifier & mask, mask, inverted))
    return np.array(table, dtype=np.int64).reshape(-1, 3)


@numba.njit("int64(uint8[:, ::1], int64, int64[:, ::1], uint8[:, ::1])", cache=True)
def select(frames: Frames, count: int, filters: NDArray[np.int64], out: Frames) -> int:
    """Copy the frames that come through to ``out``; return how many. Real-time safe.

    Args:
        frames: Batch.
        count: Rows to look at.
        filters: From :func:`compile_filters`.
        out: Written from row 0, (>= count, frame size).
    """
    kept = 0
    for row in range(count):
        identifier = can_id(frames, row)
        for k in range(filters.shape[0]):
            if ((identifier & filters[k, 1]) == filters[k, 0]) != (filters[k, 2] == 1):
                out[kept] = frames[row]
                kept += 1
                break
    return kept
