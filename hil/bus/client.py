"""One client of a virtual bus: its connection, and what it has sent but not yet won."""

from __future__ import annotations

from typing import Final

import numba
import numpy as np

from dftc_rt.bus.barrier import barrier_cycle, find_barrier
from dftc_rt.bus.frame import FD_FRAME_SIZE, FD_LENGTHS, FDF, FRAME_SIZE, Frames, frame_buffer
from dftc_rt.bus.interface import FrameSocket

INBOX_FRAMES: Final = 1024
_CODED = np.array([length in FD_LENGTHS for length in range(66)])


@numba.njit("int64(uint8[:, ::1], int64)", cache=True)
def drop_malformed(frames: Frames, count: int) -> int:
    """Close ranks over records that no CAN controller could send; return how many stay.

    Those are error frames, records longer than 8 data bytes, and FD frames of a length that has
    no code or with the remote flag.
    """
    kept = 0
    for row in range(count):
        length = int(np.int64(frames[row, 4]))
        if frames[row, 3] & 0x20:
            continue
        if frames.shape[1] == FD_FRAME_SIZE and frames[row, 5] & FDF:
            if frames[row, 3] & 0x40 or not _CODED[min(length, 65)]:
                continue
        elif length > 8:
            continue
        if kept != row:
            frames[kept] = frames[row]
        kept += 1
    return kept


class Client:
    """One node on the bus.

    Attributes:
        socket: The bus's end of the connection.
        barrier: Cycle of the barrier that the client waits at; None when it does not.
        dropped: Frames that it lost because it did not read them in time.
        malformed: Records from it that were no CAN frame.
        number: Its own, among all that have joined.
    """

    __slots__ = ("_end", "_inbox", "_start", "barrier", "dropped", "malformed", "number", "socket")

    def __init__(self, socket: FrameSocket, number: int = 0, frame_size: int = FRAME_SIZE) -> None:
        """Take over the bus's end of a connection."""
        self.number = number
        self.socket = socket
        self.barrier: int | None = None
        self.dropped = 0
        self.malformed = 0
        self._inbox = frame_buffer(INBOX_FRAMES, frame_size)
        self._start = 0
        self._end = 0

    @property
    def idle(self) -> bool:
        """Whether nothing of it waits on this side of the connection."""
        return self._start == self._end and self.barrier is None

    def receive(self, frames: Frames) -> int:
        """Receive into the caller's buffer up to a barrier; only while ``idle``.

        Raises:
            BusError: The client has left.
        """
        count = self._screened(frames, self.socket.receive(frames))
        at: int = find_barrier(frames, count)
        if at < count:
            self.barrier = barrier_cycle(frames, at)
            behind = count - at - 1
            if behind > len(self._inbox):
                self._inbox = frame_buffer(behind, self._inbox.shape[1])
            self._inbox[:behind] = frames[at + 1 : count]
            self._start, self._end = 0, behind
        return at

    def waiting(self) -> Frames:
        """Return its queue, in order and up to a barrier, refilled when empty.

        Raises:
            BusError: The client has left.
        """
        if self._start == self._end and self.barrier is None:
            self._start = 0
            self._end = self._screened(self._inbox, self.socket.receive(self._inbox))
        if self.barrier is not None:
            return self._inbox[:0]
        at = find_barrier(self._inbox[self._start :], self._end - self._start)
        if at == 0 and self._start < self._end:
            self.barrier = barrier_cycle(self._inbox, self._start)
            self._start += 1
        return self._inbox[self._start : self._start + at]

    def won(self, count: int) -> None:
        """Take the first ``count`` frames off its queue, and meet a barrier behind them."""
        self._start += count
        if count and self._start < self._end:
            self.waiting()

    def _screened(self, frames: Frames, count: int) -> int:
        kept: int = drop_malformed(frames, count)
        self.malformed += count - kept
        return kept
