"""A recording in place of the rig: it answers in its own order, and names what differs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.barrier import find_barrier, write_barrier
from dftc_rt.bus.frame import frame_buffer, pack, unpack
from dftc_rt.bus.frame_record import record_dtype
from dftc_rt.bus.inprocess import InProcessSocket
from hil.bus.inprocess import InProcessPort
from hil.playback import Difference, Player

SYNC, COMMAND, ANSWER = 0x80, 0x201, 0x181
Frame = tuple[int, bytes]


def tape(*frames: tuple[int, bool, int, bytes]) -> NDArray[np.void]:
    """Return a recording of (bus, sent by the controller, identifier, data)."""
    found = np.zeros(len(frames), record_dtype(8))
    for record, (bus, tx, can_id, data) in zip(found, frames, strict=True):
        record["bus"], record["tx"], record["id"], record["length"] = bus, tx, can_id, len(data)
        record["data"][: len(data)] = np.frombuffer(data, np.uint8)
    found["t"] = np.arange(len(frames)) * 1e-3
    return found


CYCLES = tape(
    (0, False, 0x701, b"\x00"),  # boot-up, before the controller says anything
    (0, True, SYNC, b"\x01"),
    (0, False, ANSWER, b"one"),
    (1, True, SYNC, b"\x01"),
    (0, True, COMMAND, b"\x0f\x00"),
    (0, False, 0x081, b"late"),
    (1, False, ANSWER, b"two"),
    (0, True, SYNC, b"\x02"),
    (0, False, ANSWER, b"three"),
    (1, True, SYNC, b"\x02"),
)


class Bench:
    """A player and a controller's node on each of its buses."""

    def __init__(self, records: NDArray[np.void] = CYCLES) -> None:
        self.ports = [InProcessPort(name, timing="off") for name in ("can0", "can1")]
        self.nodes: list[InProcessSocket] = [port.connect() for port in self.ports]
        self.player = Player(self.ports, records)

    def send(self, bus: int, *frames: Frame, barrier: int | None = None) -> list[Frame]:
        """Send in one go; return what comes back, a barrier as (-1, cycle)."""
        out = frame_buffer(len(frames) + 1)
        for row, (can_id, data) in enumerate(frames):
            out[row] = np.frombuffer(pack(can_id, data), np.uint8)
        if barrier is not None:
            write_barrier(out, len(frames), barrier)
        self.nodes[bus].send(out, len(frames) + (barrier is not None))
        self.player.service([bus])
        inbox = frame_buffer(64)
        count = self.nodes[bus].receive(inbox)
        at = find_barrier(inbox, count)
        found = [unpack(inbox[row]) for row in range(at)]
        return found + [(-1, inbox[at, 8:].tobytes())] * (at < count)


def described(found: Difference | None) -> tuple[int, int, Frame | None, Frame | None]:
    assert found is not None

    def frame(record: NDArray[np.void] | None) -> Frame | None:
        if record is None:
            return None
        return int(record["id"][0]), record["data"][0][: record["length"][0]].tobytes()

    return found.number, found.bus, frame(found.expected), frame(found.found)


def test_each_answer_follows_the_frame_that_it_followed() -> None:
    bench = Bench()
    assert bench.send(0, (SYNC, b"\x01")) == [(0x701, b"\x00"), (ANSWER, b"one")]
    assert bench.send(1, (SYNC, b"\x01")) == [(ANSWER, b"two")]
    assert bench.send(0, (COMMAND, b"\x0f\x00")) == [(0x081, b"late")]
    assert not bench.player.complete
    assert described(bench.player.missing()) == (7, 0, (SYNC, b"\x02"), None)
    assert bench.send(0, (SYNC, b"\x02")) == [(ANSWER, b"three")]
    assert bench.send(1, (SYNC, b"\x02")) == []
    assert bench.player.complete
    assert bench.player.missing() is None
    assert (bench.player.compared, bench.player.differing, bench.player.first) == (5, 0, None)


def test_in_lockstep_the_barrier_comes_behind_the_answers() -> None:
    bench = Bench()
    barrier = (-1, (7).to_bytes(8, "little"))
    found = bench.send(0, (SYNC, b"\x01"), (COMMAND, b"\x0f\x00"), (SYNC, b"\x02"), barrier=7)
    answers = [(0x701, b"\x00"), (ANSWER, b"one"), (0x081, b"late"), (ANSWER, b"three")]
    assert found == [*answers, barrier]
    assert bench.send(1, barrier=7) == [barrier]  # nothing was sent there, nothing is answered


def test_other_data_is_counted_and_playing_goes_on() -> None:
    bench = Bench()
    bench.send(1, (SYNC, b"\x01"))
    assert bench.send(1, (SYNC, b"\x07")) == []
    bench.send(0, (SYNC, b"\x01"))
    assert bench.send(0, (COMMAND, b"\x0f\x01")) == [(0x081, b"late")]
    assert bench.send(0, (SYNC, b"\x02")) == [(ANSWER, b"three")]
    assert bench.player.complete
    assert (bench.player.compared, bench.player.differing) == (5, 2)
    # The first of the recording, not the first that came.
    assert described(bench.player.first) == (4, 0, (COMMAND, b"\x0f\x00"), (COMMAND, b"\x0f\x01"))
    assert bench.player.first is not None
    assert bench.player.first.data_only


def test_another_frame_ends_it() -> None:
    for other in ((COMMAND, b"\x0f\x00"), (SYNC, b"\x01\x01"), (SYNC, b"")):
        bench = Bench()
        assert bench.send(0, other) == [(0x701, b"\x00")]
        assert bench.player.derailed
        assert described(bench.player.first) == (1, 0, (SYNC, b"\x01"), other)
        assert bench.send(0, (SYNC, b"\x01")) == []


def test_a_frame_more_is_a_difference() -> None:
    bench = Bench(tape((0, True, SYNC, b"\x01")))
    bench.send(0, (SYNC, b"\x01"))
    assert bench.player.complete
    bench.send(1, (SYNC, b"\x01"))
    assert described(bench.player.first) == (1, 1, None, (SYNC, b"\x01"))
    assert bench.player.derailed


def test_what_was_in_the_buffer_behind_the_data_does_not_matter() -> None:
    bench = Bench(tape((0, True, SYNC, b"\x01")))
    out = frame_buffer(1)
    out[0] = np.frombuffer(pack(SYNC, b"\x01\xff\xff"), np.uint8)
    out[0, 4] = 1
    bench.nodes[0].send(out, 1)
    bench.player.service([0])
    assert (bench.player.compared, bench.player.first) == (1, None)
