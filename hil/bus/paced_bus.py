"""The user-space bus in time (timing ``pace``): a frame arrives at the end of its time on the wire.

What nodes send waits here for the wire. The bus is busy until the end of each frame; then the heads
of the queues contend again. So a frame of low priority waits, a repeated one takes its time twice,
and a node that babbles delays the others.

The times are those of the wire, not of the moments at which this process runs: a drive answers at
the end of the SYNC that it has heard, and a frame begins when the last one ends, however late the
process was to see it. A process that is late delivers late, and the delay does not add up. What
comes from outside is ready when it is read.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames, frame_buffer
from dftc_rt.errors import BusError
from hil.bus.impairments import BABBLER, CONTROLLER, Impairments
from hil.bus.paced_impairments import Fate, PacedImpairments
from hil.bus.statistics import BusStatistics
from hil.bus.virtual_bus import VirtualBus
from hil.bus.wire import BEGUN, NEVER, Wire

MOST_WAITING: Final = 256
"""Frames of a client that wait for the wire before its socket is no longer read."""
_READ_AGAIN: Final = MOST_WAITING // 2
_APART: Final = 1 << 32  # queues beyond the numbers of nodes: late frames above, babblers below


class PacedBus(VirtualBus):
    """A virtual bus that delivers each frame at the end of its time on the wire; a ``BusPort``.

    :meth:`take_in` reads the clients, :meth:`receive` delivers what is through. A client of which
    too much waits is not read meanwhile, so that its own socket fills, as a transmit queue would.

    Attributes:
        moment: End of the frame that was received last, ns, or the time of the last
            :meth:`take_in`, whichever came later: when what the drives send now is ready.
    """

    def __init__(
        self,
        name: str,
        *,
        bitrate: int = 1_000_000,
        data_bitrate: int | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Open a bus without clients.

        Args:
            name: Logical bus name.
            bitrate: Bits per second.
            data_bitrate: Of the data part of FD frames; None: a classical bus.
            clock: Time, ns.
        """
        super().__init__(name, timing="account", bitrate=bitrate, data_bitrate=data_bitrate)
        self.moment = clock()
        self._clock = clock
        self._wire = Wire(
            self._totals, self._latency, self._extended, bitrate, data_bitrate, self.frame_size
        )
        self._one = frame_buffer(1, self.frame_size)  # the frame that has come through
        self._fate = Fate.THROUGH
        self._faults: PacedImpairments | None = None
        self._babbling: set[int] = set()  # faults of which a frame waits
        self._waiting: dict[int, int] = {}  # frames that wait, by client
        self._full: set[int] = set()  # clients that are not read
        self._apart = _APART

    @property
    def due(self) -> int:
        """When something happens on the wire next, ns; ``hil.bus.wire.NEVER``: nothing waits."""
        return self._wire.due

    def fds(self) -> list[int]:
        """Return the descriptors of the clients that are to be read."""
        return [
            client.socket.fd
            for client in self._clients
            if client.socket.fd >= 0 and client.number not in self._full
        ]

    def impair(self, impairments: Impairments) -> None:
        """Let faults of the bus act on its frames from now on: ``PacedImpairments``."""
        super().impair(impairments)
        if not isinstance(impairments, PacedImpairments):
            raise TypeError("a paced bus has paced faults")
        self._faults = impairments

    def advance(self, t: float) -> None:
        """Let rig time move on to ``t``, s: faults come and go."""
        if self._faults is None:
            return
        self._faults.advance(t)
        self._faults.tie(self._clock(), t)
        self._tell(self._faults)
        for k in self._faults.babblers():
            if k not in self._babbling:
                self._babble(self._faults, k)

    def take_in(self) -> None:
        """Let what clients have sent wait for the wire, ready from now on."""
        now = self.moment = self._clock()
        for client in tuple(self._clients):
            if client.number in self._full:
                continue
            try:
                queue = client.waiting()
            except BusError as error:
                self._leave(client, error)
                continue
            if len(queue):
                self._put(queue, 0, len(queue), CONTROLLER - client.number, now)
                waiting = self._waiting[client.number] = self._waiting.get(client.number, 0) + len(
                    queue
                )
                client.won(len(queue))
                if waiting >= MOST_WAITING:
                    self._full.add(client.number)
                    self.fds_version += 1

    def receive(self, frames: Frames) -> int:
        """Deliver what is through by now, up to one frame that is for the drives: row 0.

        Returns:
            1, and ``moment`` is the end of that frame; 0 when nothing more is through.
        """
        if self._faults is not None:
            return self._receive_faulty(self._faults, frames)
        while (sender := self._wire.next_through(self._one, self._clock())) != NEVER:
            self.moment = self._wire.end
            self._pass(sender)
            if sender < 0:
                self._read_again(sender)
                frames[:1] = self._one
                return 1
        return 0

    def send(self, frames: Frames, count: int, nodes: NDArray[np.int32] | None = None) -> None:
        """Let the drives' first ``count`` frames wait for the wire, ready at ``moment``."""
        for row in range(count):
            sender = row if nodes is None else int(nodes[row])
            self._put(frames, row, 1, sender, self.moment)

    def count_into(self, totals: NDArray[np.int64]) -> None:
        """Keep the counts of frames and bits there from now on. See ``BusPort.count_into``."""
        super().count_into(totals)
        self._wire.count_into(totals)

    @property
    def statistics(self) -> BusStatistics:
        """What has gone over the bus since it was opened."""
        mean, longest = self._wire.late_us
        return dataclasses.replace(
            super().statistics, late_mean_us=round(mean, 1), late_max_us=round(longest, 1)
        )

    def _put(self, frames: Frames, first: int, count: int, sender: int, now: int) -> None:
        if self._faults is None:
            self._wire.put(frames, first, count, sender, now)
            return
        for row in range(first, first + count):
            late = self._faults.late_ns(frames, row)
            if late:  # those sent meanwhile overtake it
                self._apart += 1
                self._wire.put(frames, row, 1, sender, now + late, self._apart)
            else:
                self._wire.put(frames, row, 1, sender, now)

    def _pass(self, sender: int) -> None:
        """Deliver the frame that has come through to every client but its sender."""
        for client in tuple(self._clients):
            if sender != CONTROLLER - client.number:
                self._deliver(client, self._one, 1)

    def _read_again(self, sender: int) -> None:
        """Read a client again of which little enough waits."""
        if sender == BABBLER:
            return
        number = CONTROLLER - sender
        self._waiting[number] -= 1
        if number in self._full and self._waiting[number] <= _READ_AGAIN:
            self._full.discard(number)
            self.fds_version += 1

    def _receive_faulty(self, faults: PacedImpairments, frames: Frames) -> int:
        """What :meth:`receive` does while faults act on the bus."""
        while happens := self._wire.begin(now := self._clock()):
            if happens == BEGUN:
                self._begin(faults)
            elif self._end(faults, now):
                frames[:1] = self._one
                return 1
        return 0

    def _begin(self, faults: PacedImpairments) -> None:
        """Decide what becomes of the frame that has begun."""
        frames, row, sender, copy = self._wire.on_wire
        if faults.off(max(sender, CONTROLLER)):
            faults.counts.lost += 1
            self._wire.cancel()
            self._done(faults, sender)
            return
        before = faults.counts.waste
        self._fate = faults.attempt(frames, row, sender, copy)
        after = faults.counts.waste
        if after != before:
            self._waste(before, after)
            self._wire.occupy((after[0] - before[0], after[1] - before[1]))

    def _end(self, faults: PacedImpairments, now: int) -> bool:
        """Take the frame off the wire and deliver it; return whether it is for the drives."""
        wire, fate, sender = self._wire, self._fate, self._wire.on_wire[2]
        if fate is Fate.AGAIN:
            wire.repeat(copy=False)
            return False
        if fate is Fate.LOST:
            self._done(faults, sender)
            return False
        wire.through(self._one, now)
        self.moment = wire.end
        if fate is Fate.TWICE:
            wire.repeat(copy=True)
        else:
            self._done(faults, sender)
        if not faults.off(CONTROLLER):
            self._pass(sender)
        return sender < 0

    def _done(self, faults: PacedImpairments, sender: int) -> None:
        """Take the frame on the wire out of its queue; a babbling node has another."""
        queue = self._wire.leave()
        if sender == BABBLER:
            self._babbling.discard(-_APART - queue)
            self._babble(faults, -_APART - queue)
        elif sender <= CONTROLLER:
            self._read_again(sender)

    def _babble(self, faults: PacedImpairments, k: int) -> None:
        """Let the next frame of a node that babbles wait for the wire."""
        found = faults.next_babble(k, self._clock())
        if found is not None:
            self._wire.put(found[0], 0, 1, BABBLER, found[1], -_APART - k)
            self._babbling.add(k)
