"""Every frame that passes the controller's sockets, to a ring, as ``--frames`` wants it.

The sockets are tapped, not the bus: what is logged is what the controller had sent and
received, in that order, whatever carries the frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Protocol

from dftc_rt.bus.frame import Frames
from dftc_rt.bus.frame_record import RecordBatch, record_data_bytes
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.ring import Ring
from dftc_rt.rt.clock import NS, Clock

_CAPACITY: Final = 512  # no less than any buffer that is sent from or received into


class RunTime(Protocol):
    """Who knows the run time.

    Attributes:
        t: Scheduled time of the present cycle, s.
        first_tick: When the clock showed t = 0, ns; 0 before that is known.
    """

    t: float
    first_tick: int


class FrameTap:
    """Writes the frames of a controller's sockets to a ring. Real-time safe.

    In lock-step a frame's time is that of the cycle in which it passed, and what set-up sends
    before the first cycle is one period before it. In real time it is the clock's, and the ring
    is told when run time began (:meth:`dftc_rt.ring.Ring.start`).
    """

    def __init__(self, ring: Ring, clock: Clock, period_s: float, frame_size: int) -> None:
        """Prepare.

        Args:
            ring: Takes records of :mod:`dftc_rt.bus.frame_record`.
            clock: The executor's.
            period_s: Period of the cycle, s.
            frame_size: Bytes of a row of the executor's buffers, 16 or 72.
        """
        self._ring = ring
        self._clock = clock
        self._before = -period_s
        data = record_data_bytes(frame_size)
        self._batch = RecordBatch(_CAPACITY, data, barriers=not clock.lockstep)
        self._run_time: RunTime | None = None
        self._started = clock.lockstep
        if clock.lockstep:
            ring.start(0)

    def tapped(self, sockets: Sequence[FrameSocket]) -> list[FrameSocket]:
        """Return sockets that do the same as these and are listened to."""
        return [_TappedSocket(socket, bus, self) for bus, socket in enumerate(sockets)]

    def follow(self, run_time: RunTime) -> None:
        """Take the time of the run from here on."""
        self._run_time = run_time

    def record(self, bus: int, tx: bool, frames: Frames, count: int) -> None:
        """Log the first rows of a batch.

        Args:
            bus: Index of the bus.
            tx: Whether the controller sent them.
            frames: Batch, as the socket had it.
            count: Rows that passed.
        """
        kept = self._batch.fill(frames, count, self._now(), bus, tx)
        self._ring.put(self._batch.words, kept)

    def _now(self) -> float:
        run_time = self._run_time
        if self._clock.lockstep:
            return self._before if run_time is None else run_time.t
        if not self._started and run_time is not None and run_time.first_tick:
            self._started = True
            self._ring.start(run_time.first_tick)
        return self._clock.now() / NS


class _TappedSocket:
    """A ``FrameSocket`` whose frames are logged."""

    __slots__ = ("_bus", "_socket", "_tap", "fd", "name")

    def __init__(self, socket: FrameSocket, bus: int, tap: FrameTap) -> None:
        self.name = socket.name
        self.fd = socket.fd
        self._socket = socket
        self._bus = bus
        self._tap = tap

    def send(self, frames: Frames, count: int) -> int:
        accepted = self._socket.send(frames, count)
        if accepted:
            self._tap.record(self._bus, True, frames, accepted)
        return accepted

    def receive(self, frames: Frames) -> int:
        count = self._socket.receive(frames)
        if count:
            self._tap.record(self._bus, False, frames, count)
        return count

    def close(self) -> None:
        self._socket.close()
        self.fd = self._socket.fd
