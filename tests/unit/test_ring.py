"""Rings in shared memory, within one process and across two."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import deque
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.errors import InputError
from dftc_rt.ring import Event, EventRing, Ring

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parents[2]


def put(ring: Ring, value: float) -> bool:
    ring.slot()[:] = value
    return ring.commit()


def take(ring: Ring) -> list[float]:
    values: list[float] = []
    while len(block := ring.drain()):
        assert (block == block[:, :1]).all()
        values += block[:, 0].tolist()
        ring.advance(len(block))
    return values


def start(script: str, *arguments: object, fd: int) -> subprocess.Popen[bytes]:
    """A child that imports the project and has ``fd``."""
    return subprocess.Popen(
        [sys.executable, "-c", script, str(fd), *map(str, arguments)],
        cwd=ROOT,
        pass_fds=[fd],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )


@given(
    slots=st.integers(2, 7),
    steps=st.lists(st.one_of(st.just(-1), st.integers(1, 9)), max_size=80),
)
def test_is_a_bounded_queue_that_drops_the_newest(slots: int, steps: list[int]) -> None:
    ring = Ring.create("test", slots, 3)
    model: deque[float] = deque()
    dropped = written = 0
    for number, step in enumerate(steps):
        if step < 0:
            kept = put(ring, float(number))
            assert kept == (len(model) < slots)
            if kept:
                model.append(float(number))
                written += 1
            else:
                dropped += 1
        else:
            block = ring.drain(step)
            assert len(block) <= step
            assert len(block) > 0 or not model
            assert block[:, 0].tolist() == [model.popleft() for _ in range(len(block))]
            ring.advance(len(block))
        assert (ring.pending, ring.dropped, ring.written) == (len(model), dropped, written)
    assert take(ring) == list(model)
    ring.close()


def test_slots_are_written_in_place() -> None:
    ring = Ring.create("test", 4, 2)
    other = Ring.attach(ring.fd)
    slot = ring.slot()
    slot[:] = 1.0
    ring.commit()
    assert other.drain().tolist() == [[1.0, 1.0]]
    slot[:] = 2.0  # the same memory, seen through another mapping
    assert other.drain().tolist() == [[2.0, 2.0]]


def test_scratch_never_becomes_a_record() -> None:
    ring = Ring.create("test", 2, 1)
    put(ring, 1.0)
    put(ring, 2.0)
    ring.slot()[:] = 3.0  # full: scratch
    ring.advance(1)  # the reader makes room in between
    assert not ring.commit()
    assert ring.dropped == 1
    assert put(ring, 4.0)
    assert take(ring) == [2.0, 4.0]


def test_a_second_reader_goes_on_where_the_first_stopped() -> None:
    ring = Ring.create("test", 8, 1)
    for value in range(5):
        put(ring, value)
    first = Ring.attach(ring.fd)
    first.advance(len(first.drain(2)))
    del first
    assert take(Ring.attach(ring.fd)) == [2.0, 3.0, 4.0]


def test_latest_is_a_copy_of_the_newest() -> None:
    ring = Ring.create("test", 4, 2)
    assert ring.latest() is None
    for value in range(6):
        put(ring, value)
        ring.advance(1)
    newest = Ring.attach(ring.fd).latest()
    assert newest is not None
    put(ring, 9.0)
    assert newest.tolist() == [5.0, 5.0]


def test_latest_is_read_again_when_the_writer_laps_it() -> None:
    ring = Ring.create("test", 3, 1)
    writer = Ring.attach(ring.fd)
    put(writer, 1.0)

    class Lapped:
        """Slot 0, overwritten by record 4 while record 1 is being copied from it."""

        def __init__(self) -> None:
            self.copies = 0

        def copy(self) -> np.ndarray:
            self.copies += 1
            if self.copies == 1:
                writer.advance(1)
                for value in (2.0, 3.0, 4.0):
                    put(writer, value)
                    writer.advance(1)
                return np.array([1.0])
            return writer._records[0].copy()

    lapped = Lapped()
    ring._views[0] = lapped  # type: ignore[call-overload]
    assert ring.latest() == np.array([4.0])
    assert lapped.copies == 2


def test_end_is_seen_by_the_reader_after_the_last_record() -> None:
    ring = Ring.create("test", 4, 1)
    reader = Ring.attach(ring.fd)
    put(ring, 1.0)
    ring.end()
    assert reader.closed
    assert not reader.finished
    assert take(reader) == [1.0]
    assert reader.finished


_WRITER = """
import sys
from dftc_rt.ring import Ring
ring = Ring.attach(int(sys.argv[1]))
for number in range(int(sys.argv[2])):
    ring.slot()[:] = number
    ring.commit()
ring.end()
"""


def test_another_process_writes_faster_than_we_read() -> None:
    count = 20_000
    ring = Ring.create("test", 16, 5)
    child = start(_WRITER, count, fd=ring.fd)
    received: list[float] = []
    while not ring.finished and (child.poll() is None or ring.pending):
        received += take(ring)
    child.communicate()
    assert child.returncode == 0
    assert len(received) == ring.written
    assert ring.written + ring.dropped == count
    assert ring.written > 16  # it wrapped around
    assert received == sorted(set(received))


_KILLED = """
import sys
from dftc_rt.ring import Ring
ring = Ring.attach(int(sys.argv[1]))
for number in range(100):
    ring.slot()[:] = number
    ring.commit()
ring.slot()[:] = -1.0  # not committed
sys.stdout.write("x")
sys.stdout.flush()
sys.stdin.read()
"""


def test_a_killed_writer_loses_nothing_committed() -> None:
    ring = Ring.create("test", 128, 3)
    child = start(_KILLED, fd=ring.fd)
    assert child.stdout is not None
    assert child.stdout.read(1) == b"x"
    child.send_signal(signal.SIGKILL)
    child.communicate()
    assert child.returncode == -signal.SIGKILL
    assert take(ring) == [float(number) for number in range(100)]
    assert not ring.closed
    ring.end()  # whoever buries the writer
    assert ring.finished


def test_what_is_no_ring_is_refused() -> None:
    fd = os.memfd_create("other")
    with pytest.raises(InputError, match="0 bytes"):
        Ring.attach(fd)
    os.ftruncate(fd, 8192)
    with pytest.raises(InputError, match="another kind of memory"):
        Ring.attach(fd)
    os.close(fd)
    with pytest.raises(InputError, match="1 slots"):
        Ring.create("test", 1, 1)


def test_nobody_can_cut_the_memory_off() -> None:
    ring = Ring.create("test", 4, 1)
    assert os.get_inheritable(ring.fd)
    with pytest.raises(PermissionError):
        os.ftruncate(ring.fd, 0)


def test_events_keep_order_and_text() -> None:
    ring = EventRing.create("test", slots=4)
    reader = EventRing.attach(ring.fd)
    for lap in range(3):
        assert ring.write(lap, 2, "can0", f"ρ̂ below 0.15, lap {lap}")
        assert ring.write(lap + 0.5, 3, "", "")
        assert reader.drain(1) == [Event(lap, 2, "can0", f"ρ̂ below 0.15, lap {lap}")]
        reader.advance(1)
        assert reader.drain() == [Event(lap + 0.5, 3, "", "")]
        reader.advance(1)


def test_events_that_do_not_fit_are_cut_between_characters() -> None:
    ring = EventRing.create("test", slots=2)
    ring.write(0.0, 1, "ä" * 100, "x" + "ρ" * 1000)
    (event,) = ring.drain()
    assert event.source == "ä" * 32
    assert event.text == "x" + "ρ" * ((512 - 16 - 64 - 1) // 2)


def test_events_that_find_the_ring_full_are_counted() -> None:
    ring = EventRing.create("test", slots=2)
    assert [ring.write(t, 1, "a", "b") for t in range(3)] == [True, True, False]
    assert ring.dropped == 1
    assert [event.t for event in ring.drain()] == [0.0, 1.0]


def test_several_records_at_once_go_round_the_end_and_drop_what_is_too_much() -> None:
    ring = Ring.create("x", 5, 2)
    block = np.arange(14.0).reshape(7, 2)
    assert ring.put(block, 4) == 4
    ring.advance(3)
    assert ring.put(block, 3) == 3  # two at the end, one at the start
    assert ring.drain().tolist() == [[6.0, 7.0], [0.0, 1.0]]
    ring.advance(2)
    assert ring.drain().tolist() == [[2.0, 3.0], [4.0, 5.0]]
    assert ring.put(block, 7) == 3
    assert ring.dropped == 4
    assert ring.pending == 5
    assert ring.put(block, 1) == 0
    assert ring.put(block, 0) == 0
    assert ring.dropped == 5


def test_the_origin_of_run_time_is_known_once_the_writer_has_said_so() -> None:
    ring = Ring.create("x", 4, 2)
    reader = Ring.attach(ring.fd)
    assert reader.origin is None
    ring.start(0)
    assert reader.origin == 0
    ring.start(123_456_789_012_345)
    assert reader.origin == 123_456_789_012_345
