"""The link for a controller and a rig that live in one process: two queues, no socket."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dftc_rt.bus.filters import send_filters
from dftc_rt.bus.frame import FRAME_SIZE, Frames, frame_buffer
from dftc_rt.bus.interface import Filters
from dftc_rt.errors import BusError

DEFAULT_CAPACITY: Final = 1024  # frames that wait at one end before send accepts no more


class FrameQueue:
    """First in, first out, of bounded size, copied in and out of NumPy rows."""

    __slots__ = ("_end", "_rows", "_start")

    def __init__(self, capacity: int, frame_size: int = FRAME_SIZE) -> None:
        """Hold at most ``capacity`` frames of ``frame_size`` bytes."""
        self._rows = frame_buffer(capacity, frame_size)
        self._start = 0
        self._end = 0

    def __len__(self) -> int:
        """Return how many frames wait."""
        return self._end - self._start

    def push(self, frames: Frames, count: int) -> int:
        """Append the first ``count`` rows; return how many found room."""
        rows = self._rows
        if self._end + count > len(rows):
            waiting = self._end - self._start
            rows[:waiting] = rows[self._start : self._end].copy()
            self._start, self._end = 0, waiting
            count = min(count, len(rows) - waiting)
        # A classical frame, such as a barrier, may come from a narrower buffer.
        rows[self._end : self._end + count, : frames.shape[1]] = frames[:count]
        self._end += count
        return count

    def pop(self, frames: Frames) -> int:
        """Move as many frames as ``frames`` has rows for; return how many."""
        start = self._start
        count = self._end - start
        if not count:
            return 0
        if count > len(frames):
            count = len(frames)
            self._start = start + count
        else:
            self._start = self._end = 0
        frames[:count] = self._rows[start : start + count]
        return count


class InProcessSocket:
    """One end of an in-process link; a ``FrameSocket``.

    Attributes:
        name: Logical bus name.
        fd: Always -1: there is nothing to wait for.
        service: Called after every ``send`` that had something accepted, so that the
            other side can answer before ``send`` returns; None when it runs by itself.
    """

    __slots__ = ("_inbox", "_peer", "fd", "name", "service")

    def __init__(self, name: str, inbox: FrameQueue) -> None:
        """Make one end; ``link`` joins two."""
        self.name = name
        self.fd = -1
        self.service: Callable[[], None] | None = None
        self._inbox = inbox
        self._peer: InProcessSocket | None = None

    def send(self, frames: Frames, count: int) -> int:
        """Send the first ``count`` rows; return how many were accepted. Never blocks.

        Raises:
            BusError: Either end is closed.
            ValueError: ``count`` exceeds the buffer.
        """
        peer = self._peer
        if peer is None:
            raise BusError(self.name, "the bus has gone away (closed)")
        if count > len(frames):
            raise ValueError(f"{count} frames asked for, the buffer holds {len(frames)}")
        if count <= 0:
            return 0
        accepted = peer._inbox.push(frames, count)
        if accepted and self.service is not None:
            self.service()
        return accepted

    def receive(self, frames: Frames) -> int:
        """Fill ``frames`` from row 0; return how many frames came. Never blocks.

        Raises:
            BusError: Either end is closed and nothing is left to read.
        """
        count = self._inbox.pop(frames)
        if not count and self._peer is None:
            raise BusError(self.name, "the bus has gone away (closed)")
        return count

    def set_filters(self, filters: Filters | None) -> None:
        """Have the bus forward only frames that one of ``filters`` takes; None: all. For set-up.

        Raises:
            InputError: There are too many.
            BusError: Either end is closed, or the other does not read.
        """
        send_filters(self, filters)

    def close(self) -> None:
        """Close both directions; the other end still reads what was sent before."""
        peer, self._peer = self._peer, None
        if peer is not None:
            peer._peer = None


def link(
    name: str, capacity: int = DEFAULT_CAPACITY, frame_size: int = FRAME_SIZE
) -> tuple[InProcessSocket, InProcessSocket]:
    """Return the two ends of a new link.

    Args:
        name: Logical bus name, of both ends.
        capacity: Frames that wait in either direction before ``send`` accepts no more.
        frame_size: Bytes of a frame.
    """
    one = InProcessSocket(name, FrameQueue(capacity, frame_size))
    other = InProcessSocket(name, FrameQueue(capacity, frame_size))
    one._peer, other._peer = other, one
    return one, other
