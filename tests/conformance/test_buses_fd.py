"""Buses that carry CAN FD frames and classical ones side by side, over every transport."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.bus.barrier import BarrierSender
from dftc_rt.bus.bits import exact_bits
from dftc_rt.bus.fd_bits import exact_fd_bits
from dftc_rt.bus.frame import (
    BRS,
    EFF_FLAG,
    FD_FRAME_SIZE,
    FD_LENGTHS,
    FDF,
    Frames,
    frame_buffer,
    pack,
    pack_fd,
    unpack,
)
from dftc_rt.bus.wait import Waiter
from dftc_rt.config import faults as kinds
from hil.bus.impairments import Impairments
from tests.conformance.bus_transports import (
    DATA_BITRATE,
    PATIENCE_S,
    Opener,
    Transport,
    batch,
    fd_inprocess,
    fd_unix,
    fd_vcan,
)

Row = tuple[bool, int, bytes]


@pytest.fixture(
    params=[
        pytest.param(fd_inprocess, id="inprocess"),
        pytest.param(fd_unix, id="unix"),
        pytest.param(fd_vcan, id="vcan", marks=pytest.mark.vcan),
    ]
)
def bus(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Transport]:
    opener: Opener = request.param
    transport = opener(tmp_path, "account")
    yield transport
    transport.close()


def rows(frames: list[Row]) -> Frames:
    out = frame_buffer(len(frames), FD_FRAME_SIZE)
    for row, (fd, can_id, data) in zip(out, frames, strict=True):
        raw = pack_fd(can_id, data) if fd else pack(can_id, data)
        row[: len(raw)] = np.frombuffer(raw, dtype=np.uint8)
    return out


def received(
    receive: Callable[[Frames], int], fds: Callable[[], list[int]], count: int
) -> list[Row]:
    buffer = frame_buffer(64, FD_FRAME_SIZE)
    buffer[:] = 0xA5  # what an earlier frame left behind
    got: list[Row] = []
    while True:
        fresh = receive(buffer)
        got += [(bool(buffer[r, 5] & FDF), *unpack(buffer[r])) for r in range(fresh)]
        if len(got) >= count:
            return got
        assert fresh or (fds() and Waiter(fds()).wait(PATIENCE_S)), f"{len(got)} of {count}"


def at_port(bus: Transport, count: int) -> list[Row]:
    return received(bus.port.receive, bus.port.fds, count)


MIXED: list[Row] = [
    (True, 0x123, bytes(range(64))),
    (False, 0x123, bytes(range(8))),
    (True, EFF_FLAG | 0x1234567, bytes(48)),
    (False, 0x7FF, b""),
    (True, 0x0, b""),
]


def test_both_kinds_keep_their_bytes_and_their_order(bus: Transport) -> None:
    node, other = bus.join(), bus.join()
    bus.port.receive(frame_buffer(4, FD_FRAME_SIZE))
    assert node.send(rows(MIXED), len(MIXED)) == len(MIXED)
    assert at_port(bus, len(MIXED)) == MIXED
    fds = [other.fd] if other.fd >= 0 else []
    assert received(other.receive, lambda: fds, len(MIXED)) == MIXED
    bus.port.send(rows(MIXED), len(MIXED), np.zeros(len(MIXED), dtype=np.int32))
    for hearer in (node, other):
        fds = [hearer.fd] if hearer.fd >= 0 else []
        assert received(hearer.receive, lambda fds=fds: fds, len(MIXED)) == MIXED


@pytest.mark.parametrize("length", FD_LENGTHS)
def test_every_length(bus: Transport, length: int) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4, FD_FRAME_SIZE))
    sent = [(True, 0x42, bytes(range(length)))]
    node.send(rows(sent), 1)
    assert at_port(bus, 1) == sent


def test_bits_of_either_rate_are_counted(bus: Transport) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4, FD_FRAME_SIZE))
    node.send(rows(MIXED), len(MIXED))
    at_port(bus, len(MIXED))
    slow = fast = 0
    for row, (fd, can_id, data) in enumerate(MIXED):
        one = exact_fd_bits(rows(MIXED), row) if fd else (exact_bits(batch([(can_id, data)]), 0), 0)
        slow, fast = slow + one[0], fast + one[1]
    done = bus.port.statistics
    assert (done.exact_bits, done.exact_data_bits) == (slow, fast)
    assert done.nominal_bits <= slow <= done.worst_bits
    assert done.nominal_data_bits <= fast <= done.worst_data_bits
    assert done.busy_s == pytest.approx(slow / 1e6 + fast / DATA_BITRATE)


def test_arbitration_does_not_mind_the_kind(bus: Transport) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4, FD_FRAME_SIZE))
    sent: list[Row] = [(True, 0x300, bytes(64)), (False, 0x100, b"a"), (True, 0x200, b"b")]
    bus.port.send(rows(sent), 3, np.arange(3, dtype=np.int32))
    fds = [node.fd] if node.fd >= 0 else []
    assert received(node.receive, lambda: fds, 3) == [sent[1], sent[2], sent[0]]


def test_a_barrier_is_a_classical_frame(bus: Transport) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4, FD_FRAME_SIZE))
    node.send(rows(MIXED[:1]), 1)
    BarrierSender().send(node, 7)
    assert at_port(bus, 1) == MIXED[:1]
    while not bus.port.barrier_pending:
        bus.port.receive(frame_buffer(4, FD_FRAME_SIZE))
    assert bus.port.pop_barrier() == 7
    bus.port.send_barrier(7)


def test_faults_act_on_them(bus: Transport) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4, FD_FRAME_SIZE))
    twice = [kinds.FrameDuplicationFault(bus="can0", probability=1.0)]
    size = bus.port.frame_size
    bus.port.impair(Impairments("can0", twice, 1, 0, lambda *_: None, size))
    bus.port.advance(0.0)
    node.send(rows(MIXED), len(MIXED))
    assert at_port(bus, 2 * len(MIXED)) == [row for row in MIXED for _ in range(2)]


def test_what_no_controller_could_send_is_left_out(tmp_path: Path) -> None:
    bus = fd_unix(tmp_path)
    node = bus.join()
    bad = rows([(True, 0x1, bytes(8)), (True, 0x2, bytes(8)), (False, 0x3, b""), (True, 0x4, b"")])
    bad[0, 4] = 9  # no length code
    bad[1, 3] |= 0x40  # a remote frame that is FD
    bad[2, 4] = 9
    node.send(bad, 4)
    assert at_port(bus, 1) == [(True, 0x4, b"")]
    assert bus.port.statistics.malformed == 3
    bus.close()


def test_a_classical_node_does_not_hear_fd_frames(tmp_path: Path) -> None:
    bus = fd_unix(tmp_path)
    node = bus.join()
    bus.port.receive(frame_buffer(4, FD_FRAME_SIZE))
    bus.port.send(rows(MIXED), len(MIXED))
    narrow = frame_buffer(16)
    assert node.receive(narrow) == 2
    assert [unpack(narrow[r]) for r in range(2)] == [row[1:] for row in MIXED if not row[0]]
    bus.close()


def test_without_brs_all_bits_are_slow() -> None:
    frame = rows([(True, 0x1, bytes(range(20)))])
    fast = exact_fd_bits(frame, 0)
    frame[0, 5] &= 0xFF ^ BRS
    slow = exact_fd_bits(frame, 0)
    assert slow[1] == 0
    assert abs(slow[0] - sum(fast)) <= 1
