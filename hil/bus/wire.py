"""The wire of one bus in time: one frame at a time, each for as long as its bits take.

Frames wait in one queue a node. Whenever the wire is free, the heads of the queues that are ready
by then contend, and the lowest identifier wins; what becomes ready meanwhile waits for the end. The
wire keeps no clock: it is told when a frame is ready, and says when something happens next.

Source: ISO 11898-1:2015, "Medium access control" (arbitration, interframe space).
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.bits import exact_bits
from dftc_rt.bus.fd_bits import exact_fd_bits
from dftc_rt.bus.frame import FD_FRAME_SIZE, FDF, FRAME_SIZE, Frames, frame_buffer
from hil.bus.arbitration import arbitration_key

I64 = NDArray[np.int64]

NEVER: Final = 1 << 62
"""A time, ns, that does not come."""
_NS: Final = 1_000_000_000
_NEVER = NEVER


@numba.njit("UniTuple(int64, 2)(uint8[:, ::1], int64[::1], int64[::1], int64, int64)", cache=True)
def next_winner(frames: Frames, queues: I64, ready: I64, count: int, free: int) -> tuple[int, int]:
    """Return which frame gets the wire next, and when it begins.

    Args:
        frames: What waits, in order of hand-over, (capacity, frame size).
        queues: Queue of each row; the first row of each is its head, (>= count,).
        ready: When each row is ready, ns, (>= count,).
        count: Rows that wait.
        free: When the wire becomes free, ns.

    Returns:
        Row, -1 when nothing waits; time, ns.
    """
    heads = np.empty(count, dtype=np.int64)
    known = 0
    start = _NEVER
    for row in range(count):
        behind = False
        for k in range(known):
            if queues[heads[k]] == queues[row]:
                behind = True
                break
        if not behind:
            heads[known] = row
            known += 1
            start = min(start, ready[row])
    start = max(start, free)
    winner = -1
    best = 0
    for k in range(known):
        row = heads[k]
        if ready[row] <= start:
            key = arbitration_key(frames, row)
            if winner < 0 or key < best:
                winner = row
                best = key
    return winner, start


@numba.njit("void(uint8[:, ::1], int64[:, ::1], int64, int64)", cache=True)
def _close_gap(frames: Frames, about: I64, row: int, count: int) -> None:
    """Move the rows behind ``row`` up by one."""
    for k in range(row, count - 1):
        frames[k] = frames[k + 1]
        for i in range(about.shape[0]):
            about[i, k] = about[i, k + 1]


class Wire:
    """What waits for a bus, and the one frame on it.

    Attributes:
        bits: Of the frame on the wire: at the bit rate, at the data bit rate.
        end: When the frame on the wire is through, ns; the wire is free from then on.
    """

    _QUEUE, _SENDER, _READY, _REPEATS = range(4)

    def __init__(
        self, bitrate: int, data_bitrate: int | None = None, frame_size: int = FRAME_SIZE
    ) -> None:
        """Begin with a free wire and empty queues.

        Args:
            bitrate: Bits per second.
            data_bitrate: Of the data part of FD frames; None: a classical bus.
            frame_size: Bytes of a row, 16 or 72.
        """
        self._bitrate = bitrate
        self._data_bitrate = data_bitrate or bitrate
        self._rows = frame_buffer(64, frame_size)
        self._about = np.zeros((4, 64), dtype=np.int64)
        self._count = 0
        self._row = -1  # the frame on the wire, which stays where it is until it is through
        self._due = NEVER
        self.bits = (0, 0)
        self.end = 0

    def put(
        self,
        frames: Frames,
        row: int,
        sender: int,
        ready: int,
        queue: int | None = None,
    ) -> None:
        """Let a frame wait for the wire, behind the others of its queue.

        Args:
            frames: Batch; left as it is.
            row: Row of the frame.
            sender: Node that sends it.
            ready: When it is handed over, ns.
            queue: Queue that it waits in; the sender's own by default.
        """
        if self._count == len(self._rows):
            rows, about = self._rows, self._about
            self._rows = frame_buffer(2 * len(rows), rows.shape[1])
            self._about = np.zeros((4, 2 * len(rows)), dtype=np.int64)
            self._rows[: len(rows)], self._about[:, : len(rows)] = rows, about
        at = self._count
        self._rows[at] = frames[row]
        self._about[:, at] = sender if queue is None else queue, sender, ready, 0
        self._count = at + 1
        self._due = -1

    @property
    def due(self) -> int:
        """When something happens next, ns: the end of the frame on the wire, or a beginning."""
        if self._row >= 0:
            return self.end
        if self._due < 0:
            self._due = self._next()[1]
        return self._due

    @property
    def busy(self) -> bool:
        """Whether a frame is on the wire."""
        return self._row >= 0

    def begin(self) -> tuple[Frames, int, int, bool]:
        """Put the winner on the wire; :meth:`occupy` then says how long it takes.

        Returns:
            Frames and row of the winner, its sender, and whether it is a repetition.
        """
        self._row, self.end = self._next()
        row = self._row
        return self._rows, row, int(self._about[self._SENDER, row]), bool(
            self._about[self._REPEATS, row]
        )  # fmt: skip

    def occupy(self, bits: tuple[int, int] | None = None) -> None:
        """Let the frame on the wire take its time.

        Args:
            bits: At the bit rate and at the data bit rate; by default the frame's own.
        """
        if bits is None:
            bits = frame_bits(self._rows, self._row)
        self.bits = bits
        self.end += round(_NS * bits[0] / self._bitrate + _NS * bits[1] / self._data_bitrate)

    def waited(self) -> int:
        """Return the time from readiness to the end of the frame on the wire, ns."""
        return self.end - int(self._about[self._READY, self._row])

    def frame(self) -> Frames:
        """Return the frame on the wire, (frame size,)."""
        row: Frames = self._rows[self._row]
        return row

    def leave(self) -> int:
        """Take the frame off the wire and out of its queue; return which queue that was."""
        queue = int(self._about[self._QUEUE, self._row])
        _close_gap(self._rows, self._about, self._row, self._count)
        self._count -= 1
        self._row = self._due = -1
        return queue

    def repeat(self, copy: bool) -> None:
        """Take the frame off the wire; it stays the head of its queue and contends again.

        Args:
            copy: It came through, and comes a second time.
        """
        if copy:
            self._about[self._REPEATS, self._row] = 1
        self._row = self._due = -1

    def _next(self) -> tuple[int, int]:
        about = self._about
        found: tuple[int, int] = next_winner(
            self._rows, about[self._QUEUE], about[self._READY], self._count, self.end
        )
        return found


def frame_bits(frames: Frames, row: int) -> tuple[int, int]:
    """Return the bits of a frame, classical or FD: at the bit rate, at the data bit rate.

    Args:
        frames: Batch, uint8, shape ``(capacity, 16)`` or ``(capacity, 72)``.
        row: Row of the frame.
    """
    if frames.shape[1] == FD_FRAME_SIZE and frames[row, 5] & FDF:
        slow, fast = exact_fd_bits(frames, row)
        return int(slow), int(fast)
    return int(exact_bits(frames, row)), 0
