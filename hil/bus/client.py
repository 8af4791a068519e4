"""One client of a virtual bus: its connection, and what it has sent but not yet won."""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.barrier import barrier_cycle, find_barrier
from dftc_rt.bus.fields import can_id
from dftc_rt.bus.filters import FILTER_ID, MOST_FILTERS, compile_filters, select
from dftc_rt.bus.frame import FD_FRAME_SIZE, FD_LENGTHS, FDF, FRAME_SIZE, Frames, frame_buffer
from dftc_rt.bus.interface import FrameSocket

INBOX_FRAMES: Final = 1024
_CODED = np.array([length in FD_LENGTHS for length in range(66)])


_FILTER_ID = FILTER_ID


@numba.njit("UniTuple(int64, 2)(uint8[:, ::1], int64, uint8[:, ::1])", cache=True)
def screen(frames: Frames, count: int, asked: Frames) -> tuple[int, int]:
    """Close ranks over records that no CAN controller could send.

    Those are error frames, records longer than 8 data bytes, and FD frames of a length that has
    no code or with the remote flag; and the records of filters, which are no frames.

    Args:
        frames: Batch, what stays moved up in place.
        count: Rows filled.
        asked: Written from row 0: records of filters, (>= count, 16).

    Returns:
        Frames that stay; records of filters.
    """
    kept = 0
    filters = 0
    for row in range(count):
        length = int(np.int64(frames[row, 4]))
        if frames[row, 3] & 0x20:
            if can_id(frames, row) == _FILTER_ID:
                asked[filters] = frames[row, :16]
                filters += 1
            continue
        if frames.shape[1] == FD_FRAME_SIZE and frames[row, 5] & FDF:
            if frames[row, 3] & 0x40 or not _CODED[min(length, 65)]:
                continue
        elif length > 8:
            continue
        if kept != row:
            frames[kept] = frames[row]
        kept += 1
    return kept, filters


class Client:
    """One node on the bus.

    Attributes:
        socket: The bus's end of the connection.
        barrier: Cycle of the barrier that the client waits at; None when it does not.
        dropped: Frames that it lost because it did not read them in time.
        malformed: Records from it that were no CAN frame.
        number: Its own, among all that have joined.
        filters: What it takes, as of ``compile_filters``; None: everything.
    """

    __slots__ = (
        "_asked", "_building", "_chosen", "_end", "_inbox", "_start", "barrier", "dropped",
        "filters", "malformed", "number", "socket",
    )  # fmt: skip

    def __init__(self, socket: FrameSocket, number: int = 0, frame_size: int = FRAME_SIZE) -> None:
        """Take over the bus's end of a connection."""
        self.number = number
        self.socket = socket
        self.barrier: int | None = None
        self.dropped = 0
        self.malformed = 0
        self.filters: NDArray[np.int64] | None = None
        self._asked = frame_buffer(INBOX_FRAMES)
        self._building: list[tuple[int, int]] = []  # the set that is being handed over
        self._chosen = frame_buffer(0, frame_size)
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

    def chosen(self, frames: Frames, count: int, filters: NDArray[np.int64]) -> tuple[Frames, int]:
        """Return what of a batch its filters take, in a buffer that the next call overwrites."""
        if count > len(self._chosen):
            self._chosen = frame_buffer(max(count, 64), frames.shape[1])
        return self._chosen, select(frames, count, filters, self._chosen)

    def _screened(self, frames: Frames, count: int) -> int:
        if count > len(self._asked):
            self._asked = frame_buffer(count)
        kept, asked = map(int, screen(frames, count, self._asked))
        self.malformed += count - kept - asked
        for record in self._asked[:asked]:
            self._filter(record.tobytes())
        return kept

    def _filter(self, record: bytes) -> None:
        """Take a filter into the set that is handed over, or put the set in force."""
        if record[4] == 8 and len(self._building) < MOST_FILTERS:
            identifier, mask = record[8:12], record[12:16]
            pair = int.from_bytes(identifier, "little"), int.from_bytes(mask, "little")
            self._building.append(pair)
        elif record[4] == 0:
            self.filters = compile_filters(self._building)
            self._building = []
        else:
            self.malformed += 1
