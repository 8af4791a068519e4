"""A recording in place of the rig: what the drives sent, each frame when its time has come.

Time is the order on a bus. What the controller sends is compared with what was sent in the
recording; behind its last frame that has come go the drives' frames that followed it then. So
the controller paces the playback, by the barriers of lock-step or by its clock, and one that
does the same on the same frames sends the same, bit for bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import frame_buffer
from dftc_rt.bus.frame_record import RecordBatch, Records, frames_of
from hil.bus.port import BusPort
from hil.loop import Watch

_CAPACITY: Final = 512
_TIME_BYTES: Final = 8  # of a record; the rest is the frame
_LOOK_S: Final = 0.1
_QUIET_S: Final = 0.5  # behind the recording's end, until nothing more is taken to come


@dataclass(frozen=True)
class Difference:
    """A frame that is not what was recorded.

    Attributes:
        number: Where it is among the recorded frames; behind them all when none was expected.
        bus: Index of the bus.
        expected: Record of the frame that was sent in the recording, (1,); None: none.
        found: Record of the frame that has come, (1,); None: none.
    """

    number: int
    bus: int
    expected: Records | None
    found: Records | None

    @property
    def data_only(self) -> bool:
        """Whether the frames differ in nothing but their data."""
        if self.expected is None or self.found is None:
            return False
        return all(
            self.expected[name][0] == self.found[name][0] for name in ("id", "flags", "length")
        )


class _Tape:
    """What was recorded on one bus, and how far it has been played."""

    def __init__(self, numbers: NDArray[np.int64], records: Records, frame_size: int) -> None:
        self.numbers = numbers
        self.records = records
        self.frames = frames_of(records, frame_size)
        self.sent = records["tx"]
        raw = np.ascontiguousarray(records).view(np.uint8).reshape(-1, records.dtype.itemsize)
        self.bytes = [row.tobytes() for row in raw[:, _TIME_BYTES:]]
        # Where the next frame of the controller is, from each place on.
        places = np.where(self.sent, np.arange(len(records)), len(records))
        following = np.minimum.accumulate(places[::-1])[::-1]
        self.next_sent: list[int] = [*following.tolist(), len(records)]
        self.at = 0


class Player:
    """Plays a recording on the rig's ports, and compares.

    Attributes:
        expected: Frames of the controller in the recording.
        compared: Frames of the controller that have come.
        differing: Those of them that were not as recorded.
        first: The first of these, in the order of the recording; None: there is none.
        derailed: Whether playing ended with a frame that is another than the recorded one.
    """

    def __init__(self, ports: Sequence[BusPort], records: Records) -> None:
        """Begin at the start.

        Args:
            ports: One a bus, in the order of the recording's bus numbers.
            records: Every recorded frame, (K,).
        """
        self._ports = list(ports)
        self._tapes: list[_Tape] = []
        for bus, port in enumerate(self._ports):
            own = np.flatnonzero(records["bus"] == bus)
            self._tapes.append(_Tape(own, records[own], port.frame_size))
        size = self._ports[0].frame_size
        self._inbox = frame_buffer(_CAPACITY, size)
        self._out = frame_buffer(_CAPACITY, size)
        self._one_node = np.zeros(_CAPACITY, dtype=np.int32)
        self._dtype = records.dtype
        self._batch = RecordBatch(_CAPACITY, records["data"].shape[1], barriers=True)
        self._behind = len(records)
        self.expected = int(np.count_nonzero(records["tx"]))
        self.compared = 0
        self.differing = 0
        self.first: Difference | None = None
        self.derailed = False

    @property
    def complete(self) -> bool:
        """Whether everything has been played."""
        return all(tape.at == len(tape.records) for tape in self._tapes)

    @property
    def clients(self) -> int:
        """Nodes on the buses."""
        return sum(port.statistics.clients for port in self._ports)

    def service(self, ready: Iterable[int]) -> None:
        """Take what has come, compare, and answer.

        Args:
            ready: Indices of the buses on which something has come.

        Raises:
            BusError: A bus has gone away.
        """
        for bus in ready:
            port = self._ports[bus]
            while not self.derailed:
                count = port.receive(self._inbox)
                if count:
                    self._take(bus, count)
                if port.barrier_pending:
                    port.send_barrier(port.pop_barrier() or 0)
                elif not count:
                    break

    def missing(self) -> Difference | None:
        """Return the first recorded frame of the controller that has not come; None: all have."""
        waiting = [
            (int(tape.numbers[k]), bus, k)
            for bus, tape in enumerate(self._tapes)
            if (k := tape.next_sent[tape.at]) < len(tape.records)
        ]
        if not waiting:
            return None
        number, bus, k = min(waiting)
        return Difference(number, bus, self._tapes[bus].records[k : k + 1], None)

    def _take(self, bus: int, count: int) -> None:
        tape = self._tapes[bus]
        self._answer(bus)  # what the drives said before the controller's first frame
        self._batch.fill(self._inbox, count, 0.0, bus, True)
        for row in range(count):
            raw = self._batch.raw[row]
            self.compared += 1
            if tape.at == len(tape.records):
                self._differ(Difference(self._behind, bus, None, self._record(row)))
            elif tape.bytes[tape.at] == raw[_TIME_BYTES:].tobytes():
                tape.at += 1
            else:
                number, expected = int(tape.numbers[tape.at]), tape.records[tape.at : tape.at + 1]
                self._differ(Difference(number, bus, expected, self._record(row)))
                tape.at += 1
            if self.derailed:
                return
            self._answer(bus)

    def _record(self, row: int) -> Records:
        record: Records = self._batch.raw[row].copy().view(self._dtype)
        return record

    def _differ(self, found: Difference) -> None:
        self.differing += 1
        self.derailed = not found.data_only
        if self.first is None or found.number < self.first.number:
            self.first = found

    def _answer(self, bus: int) -> None:
        """Send the drives' frames up to the controller's next."""
        tape, port = self._tapes[bus], self._ports[bus]
        end = tape.next_sent[tape.at]
        while tape.at < end:
            count = min(end - tape.at, _CAPACITY)
            self._out[:count] = tape.frames[tape.at : tape.at + count]
            port.send(self._out, count, self._one_node)  # of one node: they keep their order
            tape.at += count


def run_playback(player: Player, ports: Sequence[BusPort], ended: Callable[[], bool]) -> None:
    """Play until the end, until the controller has gone or does something else, or ``ended``.

    Behind the end it listens on for a moment: a frame more is a difference, too.

    Args:
        player: What is played.
        ports: Its ports.
        ended: Asked ten times a second, and after every frame.

    Raises:
        BusError: A bus has gone away.
    """
    watch = Watch(ports)
    heard = time.monotonic()
    while not (ended() or player.derailed):
        if ready := watch.wait(_LOOK_S):
            player.service(ready)
            heard = time.monotonic()
            continue
        over = player.complete and time.monotonic() - heard > _QUIET_S
        if over or (player.compared and not player.clients):
            return
