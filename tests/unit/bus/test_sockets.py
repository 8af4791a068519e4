"""Batched system calls, the in-process queue and the wait, where conformance does not reach."""

from __future__ import annotations

import ctypes
import errno
import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import dftc_rt.bus.wait as waiting
from dftc_rt.bus.barrier import find_barrier, write_barrier
from dftc_rt.bus.frame import FD_FRAME_SIZE, FDF, Frames, frame_buffer
from dftc_rt.bus.inprocess import FrameQueue, link
from dftc_rt.bus.unix import UnixSocket, connect
from dftc_rt.bus.wait import Waiter, wait
from dftc_rt.errors import BusError

pytestmark = pytest.mark.realtime


def counted(count: int, first: int = 0, size: int = 16) -> Frames:
    frames = frame_buffer(count, size)
    frames[:, size - 1] = np.arange(first, first + count)
    return frames


@pytest.fixture
def raw() -> Iterator[tuple[UnixSocket, socket.socket]]:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    node = UnixSocket("can0", one)
    yield node, other
    node.close()
    other.close()


def test_slices_and_whole_buffers_may_alternate(raw: tuple[UnixSocket, socket.socket]) -> None:
    node, other = raw
    frames = counted(8)
    sent = []
    for start, count in ((0, 8), (2, 3), (0, 1), (2, 6), (0, 8), (5, 3)):
        view = frames[start : start + count]
        assert node.send(view, count) == count
        sent += [bytes(row) for row in view]
    assert [other.recv(64) for _ in sent] == sent


def test_a_buffer_at_the_address_of_a_shorter_one(raw: tuple[UnixSocket, socket.socket]) -> None:
    node, other = raw
    storage = frame_buffer(8)
    for record in counted(8):
        other.send(record.tobytes())
    assert node.receive(storage[:2]) == 2
    assert node.receive(storage[:6]) == 6
    assert storage[:6, 15].tolist() == [2, 3, 4, 5, 6, 7]


def test_more_buffers_than_are_remembered(raw: tuple[UnixSocket, socket.socket]) -> None:
    node, other = raw
    for number in range(200):
        assert node.send(counted(1, number), 1) == 1
        assert other.recv(64)[15] == number


def test_fd_frames_travel_in_rows_of_72_bytes(raw: tuple[UnixSocket, socket.socket]) -> None:
    node, other = raw
    frames = counted(3, size=FD_FRAME_SIZE)
    frames[:, 5] = FDF
    assert node.send(frames, 3) == 3
    assert [other.recv(100) for _ in range(3)] == [bytes(row) for row in frames]


def test_records_of_another_length_are_left_out(raw: tuple[UnixSocket, socket.socket]) -> None:
    node, other = raw
    good = counted(3)
    for record in (good[0].tobytes(), b"short", bytes(72), good[1].tobytes(), good[2].tobytes()):
        other.send(record)
    frames = frame_buffer(8)
    assert node.receive(frames) == 3
    assert np.array_equal(frames[:3], good)


def test_what_was_sent_before_closing_is_still_received(
    raw: tuple[UnixSocket, socket.socket],
) -> None:
    node, other = raw
    node.send(counted(1), 1)  # unread: the close resets the connection
    for record in counted(2):
        other.send(record.tobytes())
    other.close()
    frames = frame_buffer(8)
    assert node.receive(frames) == 2
    with pytest.raises(BusError, match="can0"):
        node.receive(frames)


@pytest.mark.parametrize(
    "frames",
    [np.zeros((4, 32), np.uint8)[:, ::2], np.zeros((4, 2)), np.zeros(16, np.uint8)],
    ids=["strided", "float", "flat"],
)
def test_other_layouts_are_refused(raw: tuple[UnixSocket, socket.socket], frames: Frames) -> None:
    node, _ = raw
    with pytest.raises(ValueError, match="C-contiguous"):
        node.send(frames, 1)


def test_a_count_beyond_the_buffer_is_refused(raw: tuple[UnixSocket, socket.socket]) -> None:
    node, _ = raw
    with pytest.raises(ValueError, match="the buffer holds 2"):
        node.send(counted(2), 3)
    one, _ = link("can0")
    with pytest.raises(ValueError, match="the buffer holds 2"):
        one.send(counted(2), 3)


def test_a_bus_that_nobody_opened(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="no rig has this bus open"):
        connect("can0", tmp_path)


def test_the_queue_keeps_order_around_its_end() -> None:
    queue = FrameQueue(5)
    out = frame_buffer(3)
    assert queue.push(counted(4), 4) == 4
    assert queue.pop(out) == 3
    assert queue.push(counted(6, 4), 6) == 4  # one waits, four find room
    assert len(queue) == 5
    assert queue.pop(out) == 3
    assert queue.push(counted(1, 8), 1) == 1
    assert queue.push(counted(2, 9), 2) == 2  # moved down, with room to spare
    assert len(queue) == 5
    got: list[int] = out[:, 15].tolist()
    while count := queue.pop(out):
        got += out[:count, 15].tolist()
    assert got == [3, 4, 5, 6, 7, 8, 9, 10]


def test_the_service_runs_inside_send_and_its_errors_are_not_lost() -> None:
    node, rig = link("can0")
    buffer = frame_buffer(4)

    def echo() -> None:
        rig.send(buffer, rig.receive(buffer))

    node.service = echo
    assert node.send(counted(2), 2) == 2
    got = frame_buffer(4)
    assert node.receive(got) == 2
    rig.close()
    with pytest.raises(BusError):
        node.send(counted(1), 1)


def test_waiting_sees_a_frame_and_a_closed_end(raw: tuple[UnixSocket, socket.socket]) -> None:
    node, other = raw
    waiter = Waiter([node.fd])
    assert not waiter.wait(0.0)
    assert not waiter.wait(-1.0)
    other.send(bytes(16))
    assert waiter.wait(60.0)
    node.receive(frame_buffer(4))
    assert not waiter.wait(0.0)
    other.close()
    assert waiter.wait(60.0)


def test_nothing_is_waited_for_in_process() -> None:
    assert wait(list(link("can0")), 60.0)


def test_a_signal_does_not_end_the_wait(
    raw: tuple[UnixSocket, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    node, other = raw
    poll = waiting._ppoll
    asked: list[float] = []

    def interrupted_once(fds: int, count: int, timeout: int, mask: None) -> int:
        left = waiting._TimeSpec.from_address(timeout)
        asked.append(left.seconds + 1e-9 * left.nanoseconds)
        if len(asked) == 1:
            other.send(bytes(16))
            ctypes.set_errno(errno.EINTR)
            return -1
        ready: int = poll(fds, count, timeout, mask)
        return ready

    monkeypatch.setattr(waiting, "_ppoll", interrupted_once)
    assert wait([node], 60.0)
    assert asked[0] == 60.0
    assert 0.0 < asked[1] < 60.0


def test_a_refused_poll_is_not_taken_for_a_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        ctypes.set_errno(errno.EINVAL)
        return -1

    monkeypatch.setattr(waiting, "_ppoll", refuse)
    with pytest.raises(OSError, match="Invalid argument"):
        Waiter([0]).wait(1.0)


def test_a_barrier_is_found_by_its_whole_identifier() -> None:
    frames = frame_buffer(4)
    frames[0, :4] = [0xFE, 0xFF, 0xFF, 0x1F]  # the number without the flag of 29 bits
    write_barrier(frames, 2, 1)
    assert find_barrier(frames, 4) == 2
    assert find_barrier(frames, 2) == 2
    assert find_barrier(frames, 0) == 0
