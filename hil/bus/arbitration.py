"""Who wins the bus: the heads of the nodes' queues contend, the lowest identifier wins."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.fields import can_id
from dftc_rt.bus.frame import Frames


@numba.njit("int64(uint8[:, ::1], int64)", cache=True)
def arbitration_key(frames: Frames, row: int) -> int:
    """Return the arbitration field of a frame as a number; the lower wins.

    The bits in the order of the wire: 11 bits of identifier, RTR (or SRR, recessive),
    IDE, the other 18 bits of a long identifier, its RTR. So 0x123 beats every 29-bit
    identifier that begins with it, and data beats a remote request.

    Source: Bosch CAN 2.0 (1991), part B, 3.1.1.
    """
    identifier: int = can_id(frames, row)
    remote = (identifier >> 30) & 1
    if identifier >> 31:
        base = (identifier >> 18) & 0x7FF
        return base << 21 | 3 << 19 | (identifier & 0x3FFFF) << 1 | remote
    return (identifier & 0x7FF) << 21 | remote << 20


@numba.njit("boolean(uint8[:, ::1], int64)", cache=True)
def is_ordered(frames: Frames, count: int) -> bool:
    """Return whether the first ``count`` frames already stand in order of identifier."""
    last = 0
    for row in range(count):
        key = arbitration_key(frames, row)
        if key < last:
            return False
        last = key
    return True


@numba.njit("void(uint8[:, ::1], int64, int64[::1])", cache=True)
def order_by_identifier(frames: Frames, count: int, order: NDArray[np.int64]) -> None:
    """Write the rows in order of identifier; equal identifiers stay in order.

    Args:
        frames: Classical batch, uint8, shape ``(capacity, 16)``.
        count: Rows that contend.
        order: Row numbers in wire order, written in place, shape ``(>= count,)``.
    """
    for row in range(count):
        key = arbitration_key(frames, row)
        at = row
        while at > 0 and arbitration_key(frames, order[at - 1]) > key:
            order[at] = order[at - 1]
            at -= 1
        order[at] = row


@numba.njit("void(uint8[:, ::1], int32[::1], int64, int64[::1])", cache=True)
def arbitrate(
    frames: Frames, nodes: NDArray[np.int32], count: int, order: NDArray[np.int64]
) -> None:
    """Write the rows in the order in which they win the bus.

    The first row of each node is the head of its queue. The heads contend; the lowest
    arbitration field wins, between equal ones the lower row; the winner's next row is
    its node's new head.

    Args:
        frames: Classical batch, uint8, shape ``(capacity, 16)``.
        nodes: Sending node of each row (any numbers), shape ``(>= count,)``.
        count: Rows that contend.
        order: Row numbers in wire order, written in place, shape ``(>= count,)``.
    """
    following = np.full(count, -1, dtype=np.int64)  # the same node's next row
    head = np.ones(count, dtype=np.bool_)
    for row in range(count):
        for later in range(row + 1, count):
            if nodes[later] == nodes[row]:
                following[row] = later
                head[later] = False
                break
    for place in range(count):
        winner = -1
        best = 0
        for row in range(count):
            if head[row]:
                key = arbitration_key(frames, row)
                if winner < 0 or key < best:
                    winner = row
                    best = key
        order[place] = winner
        head[winner] = False
        if following[winner] >= 0:
            head[following[winner]] = True
