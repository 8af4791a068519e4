"""The barrier that ends one side's share of a lock-step cycle.

It travels in the stream of frames, behind everything sent before it, as a frame
with the reserved identifier ``BARRIER_ID`` whose data are the cycle number (u64).

A number from ``OUTSIDE`` on ends no cycle: the rig answers it at once, and what comes behind it
is of no cycle either, until a barrier that ends one.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from dftc_rt.bus.fields import can_id
from dftc_rt.bus.frame import BARRIER_ID, Frames, pack
from dftc_rt.bus.interface import FrameSocket

OUTSIDE: Final = 1 << 63
"""Least number of a barrier that ends no cycle."""


def write_barrier(frames: Frames, row: int, cycle: int) -> None:
    """Write the barrier of ``cycle`` (0 … 2⁶⁴-1) into a row of a classical batch."""
    frames[row, :16] = np.frombuffer(pack(BARRIER_ID, cycle.to_bytes(8, "little")), dtype=np.uint8)


def barrier_cycle(frames: Frames, row: int) -> int:
    """Return the cycle number that the barrier in ``row`` carries."""
    return int.from_bytes(frames[row, 8:16].tobytes(), "little")


@numba.njit("int64(uint8[:, ::1], int64)", cache=True)
def find_barrier(frames: Frames, count: int) -> int:
    """Return the row of the first barrier among the first ``count``, or ``count``."""
    for row in range(count):
        if can_id(frames, row) == BARRIER_ID:
            return row
    return count


class BarrierSender:
    """Sends barriers from a buffer of its own, so that nothing is allocated a cycle."""

    __slots__ = ("_frame", "_words")

    def __init__(self) -> None:
        """Prepare the frame."""
        self._frame = np.zeros((1, 16), dtype=np.uint8)
        write_barrier(self._frame, 0, 0)
        self._words = self._frame.view("<u8")

    def send(self, socket: FrameSocket, cycle: int) -> bool:
        """Send the barrier of ``cycle``; return whether it was accepted. Never blocks.

        Raises:
            BusError: The bus has gone away.
        """
        self._words[0, 1] = cycle
        return socket.send(self._frame, 1) == 1
