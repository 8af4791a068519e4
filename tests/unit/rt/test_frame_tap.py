"""Frames that pass a controller's sockets reach the ring, in order, and with their time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.barrier import write_barrier
from dftc_rt.bus.frame import frame_buffer, pack
from dftc_rt.bus.frame_record import record_dtype, record_words
from dftc_rt.bus.inprocess import link
from dftc_rt.ring import Ring
from dftc_rt.rt.clock import FakeClock, LockstepClock
from dftc_rt.rt.frame_tap import FrameTap

DTYPE = record_dtype(8)


@dataclass
class Run:
    """Who knows the run time."""

    t: float = 0.0
    first_tick: int = 0


def ring(slots: int = 64) -> Ring:
    return Ring.create("can", slots, record_words(8))


def logged(frames: Ring) -> NDArray[np.void]:
    return frames.drain().copy().view(DTYPE)[:, 0]


def test_both_directions_of_every_bus_in_order() -> None:
    frames, clock = ring(), FakeClock()
    pairs = [link("can0"), link("can1", capacity=2)]
    tap = FrameTap(frames, clock, 0.001, 16)
    here = tap.tapped([near for near, _ in pairs])
    assert [socket.name for socket in here] == ["can0", "can1"]
    out = frame_buffer(3)
    for row in range(3):
        out[row] = np.frombuffer(pack(0x200 + row, bytes([row])), np.uint8)
    clock.time = 5_000_000_000
    assert here[0].send(out, 2) == 2
    assert frames.origin is None
    run = Run()
    tap.follow(run)
    clock.time, run.first_tick = 7_000_000_000, 8_000_000_000
    pairs[1][1].send(out, 1)
    assert here[1].receive(frame_buffer(8)) == 1
    assert here[1].receive(frame_buffer(8)) == 0
    assert here[1].send(out, 3) == 2  # the third found no room: it was never sent
    assert frames.origin == 8_000_000_000
    found = logged(frames)
    assert found["bus"].tolist() == [0, 0, 1, 1, 1]
    assert found["tx"].tolist() == [True, True, False, True, True]
    assert found["id"].tolist() == [0x200, 0x201, 0x200, 0x200, 0x201]
    assert found["t"].tolist() == [5.0, 5.0, 7.0, 7.0, 7.0]
    here[0].close()
    assert here[0].fd == -1
    assert frames.dropped == 0


def test_lockstep_has_the_time_of_the_cycle_and_no_barriers() -> None:
    frames, run = ring(), Run()
    near, _ = link("can0")
    tap = FrameTap(frames, LockstepClock(), 0.002, 16)
    (socket,) = tap.tapped([near])
    out = frame_buffer(2)
    out[0] = np.frombuffer(pack(0x80, b"\x01"), np.uint8)
    write_barrier(out, 1, 3)
    socket.send(out, 2)
    tap.follow(run)
    run.t = 1.5
    socket.send(out, 2)
    found = logged(frames)
    assert found["id"].tolist() == [0x80, 0x80]
    assert found["t"].tolist() == [-0.002, 1.5]
    assert frames.origin == 0


def test_what_finds_no_room_is_dropped_and_counted_and_nothing_waits() -> None:
    frames = ring(4)
    near, far = link("can0")
    (socket,) = FrameTap(frames, LockstepClock(), 0.001, 16).tapped([near])
    out = frame_buffer(6)
    out[:, 0] = np.arange(6)
    assert socket.send(out, 6) == 6
    assert far.receive(frame_buffer(8)) == 6
    assert (frames.pending, frames.dropped) == (4, 2)
    assert logged(frames)["id"].tolist() == [0, 1, 2, 3]
