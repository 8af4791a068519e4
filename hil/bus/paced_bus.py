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

from dftc_rt.bus.fields import can_id
from dftc_rt.bus.frame import Frames, frame_buffer
from dftc_rt.errors import BusError
from hil.bus.impairments import BABBLER, CONTROLLER, Impairments
from hil.bus.paced_impairments import Fate, PacedImpairments
from hil.bus.statistics import BusStatistics
from hil.bus.virtual_bus import VirtualBus
from hil.bus.wire import Wire

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
        self._wire = Wire(bitrate, data_bitrate, self.frame_size)
        self._one = frame_buffer(1, self.frame_size)  # the frame that has come through
        self._sender = 0
        self._fate = Fate.THROUGH
        self._faults: PacedImpairments | None = None
        self._babbling: set[int] = set()  # faults of which a frame waits
        self._waiting: dict[int, int] = {}  # frames that wait, by client
        self._full: set[int] = set()  # clients that are not read
        self._apart = _APART
        self._late_max = 0
        self._late_sum = 0
        self._through = 0

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
                self._put(queue, len(queue), CONTROLLER - client.number, now)
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
        wire = self._wire
        while wire.due <= self._clock():
            if not wire.busy:
                self._begin()
            elif self._end():
                frames[:1] = self._one
                return 1
        return 0

    def send(self, frames: Frames, count: int, nodes: NDArray[np.int32] | None = None) -> None:
        """Let the drives' first ``count`` frames wait for the wire, ready at ``moment``."""
        for row in range(count):
            self._put(frames[row : row + 1], 1, row if nodes is None else int(nodes[row]),
                      self.moment)  # fmt: skip

    @property
    def statistics(self) -> BusStatistics:
        """What has gone over the bus since it was opened."""
        return dataclasses.replace(
            super().statistics,
            late_mean_us=round(self._late_sum / max(self._through, 1) / 1e3, 1),
            late_max_us=round(self._late_max / 1e3, 1),
        )

    def _put(self, frames: Frames, count: int, sender: int, now: int) -> None:
        for row in range(count):
            late = 0 if self._faults is None else self._faults.late_ns(frames, row)
            if late:  # those sent meanwhile overtake it
                self._apart += 1
                self._wire.put(frames, row, sender, now + late, self._apart)
            else:
                self._wire.put(frames, row, sender, now)

    def _begin(self) -> None:
        """Put the winner on the wire, and decide what becomes of it."""
        wire, faults = self._wire, self._faults
        frames, row, sender, copy = wire.begin()
        self._sender, self._fate = sender, Fate.THROUGH
        if faults is None:
            wire.occupy()
        elif faults.off(max(sender, CONTROLLER)):
            faults.counts.lost += 1
            self._done()
        else:
            before = faults.counts.waste
            self._fate = faults.attempt(frames, row, sender, copy)
            after = faults.counts.waste
            wasted = after[0] - before[0], after[1] - before[1]
            self._waste(before, after)
            wire.occupy(wasted if any(wasted) else None)

    def _end(self) -> bool:
        """Take the frame off the wire and deliver it; return whether it is for the drives."""
        wire, faults, fate = self._wire, self._faults, self._fate
        if fate is Fate.AGAIN:
            wire.repeat(copy=False)
            return False
        if fate is Fate.LOST:
            self._done()
            return False
        self._one[0] = wire.frame()
        self.moment = wire.end
        self._add_up()
        if fate is Fate.TWICE:
            wire.repeat(copy=True)
        else:
            self._done()
        if faults is None or not faults.off(CONTROLLER):
            for client in tuple(self._clients):
                if self._sender != CONTROLLER - client.number:
                    self._deliver(client, self._one, 1)
        return self._sender < 0

    def _done(self) -> None:
        """Take the frame on the wire out of its queue; another may follow."""
        queue = self._wire.leave()
        if self._sender == BABBLER and self._faults is not None:
            self._babbling.discard(-_APART - queue)
            self._babble(self._faults, -_APART - queue)
        elif self._sender <= CONTROLLER:
            number = CONTROLLER - self._sender
            self._waiting[number] -= 1
            if number in self._full and self._waiting[number] <= _READ_AGAIN:
                self._full.discard(number)
                self.fds_version += 1

    def _babble(self, faults: PacedImpairments, k: int) -> None:
        """Let the next frame of a node that babbles wait for the wire."""
        found = faults.next_babble(k, self._clock())
        if found is not None:
            self._wire.put(found[0], 0, BABBLER, found[1], -_APART - k)
            self._babbling.add(k)

    def _add_up(self) -> None:
        """Count the frame that has come through, its waiting, and how late it is delivered."""
        self._charge(self._one, 1)
        if not self._one[0, 3] & 0x80:
            number = can_id(self._one, 0) & 0x7FF
            self._latency[number] = max(self._latency[number], 1e-9 * self._wire.waited())
        late = self._clock() - self._wire.end
        self._through += 1
        self._late_sum += late
        self._late_max = max(self._late_max, late)
