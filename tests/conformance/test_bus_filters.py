"""Acceptance filters mean the same on every transport: what ``include/uapi/linux/can.h`` says.

The transport ``vcan`` needs a kernel with AF_CAN, whose filters are the original; what is expected
here is written by hand from its documentation.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from dftc_rt.bus.barrier import BarrierSender, find_barrier
from dftc_rt.bus.filters import FILTER_ID, INV_FILTER, MOST_FILTERS
from dftc_rt.bus.frame import (
    EFF_FLAG,
    EFF_MASK,
    ERR_FLAG,
    FD_FRAME_SIZE,
    RTR_FLAG,
    SFF_MASK,
    frame_buffer,
    pack_fd,
)
from dftc_rt.errors import BusError, InputError
from hil.bus.inprocess import InProcessPort
from tests.conformance.bus_transports import (
    Opener,
    Transport,
    batch,
    collect,
    collect_node,
    fd_inprocess,
    fd_unix,
    numbered,
    open_inprocess,
    open_unix,
    open_vcan,
    receive_until_barrier,
)

FLAGS = EFF_FLAG | RTR_FLAG
STANDARD = (0x100, 0x17F, 0x1FF, 0x345)
REMOTE = RTR_FLAG | 0x100
EXTENDED = (EFF_FLAG | 0x100, EFF_FLAG | 0x18FF_0100)
EVERY = (*STANDARD, REMOTE, *EXTENDED)
END = (0x7FF, b"end")


@pytest.fixture(
    params=[
        pytest.param(open_inprocess, id="inprocess"),
        pytest.param(open_unix, id="unix"),
        pytest.param(open_vcan, id="vcan", marks=pytest.mark.vcan),
    ]
)
def bus(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Transport]:
    opener: Opener = request.param
    transport = opener(tmp_path, "account")
    yield transport
    transport.close()


@pytest.mark.parametrize(
    ("filters", "expected"),
    [
        # Without the flags in the mask, neither the length of the identifier nor RTR matters.
        ([(0x100, SFF_MASK)], (0x100, REMOTE, *EXTENDED)),
        ([(0x100, SFF_MASK | FLAGS)], (0x100,)),
        ([(0x100, 0x700 | FLAGS)], (0x100, 0x17F, 0x1FF)),
        ([(REMOTE, SFF_MASK | FLAGS)], (REMOTE,)),
        ([(RTR_FLAG, RTR_FLAG)], (REMOTE,)),
        ([(EFF_FLAG | 0x100, EFF_MASK | FLAGS)], (EFF_FLAG | 0x100,)),
        ([(EFF_FLAG, EFF_FLAG)], EXTENDED),
        ([(0, EFF_FLAG)], (*STANDARD, REMOTE)),
        ([(0x100 | INV_FILTER, SFF_MASK | FLAGS)], tuple(set(EVERY) - {0x100})),
        # Any of several: both of these take 0x100, which comes once all the same.
        ([(0x100, SFF_MASK | FLAGS), (0x100, 0x700 | FLAGS)], (0x100, 0x17F, 0x1FF)),
        (
            [(0x17F, SFF_MASK | FLAGS), (EFF_FLAG | 0x18FF_0100, EFF_MASK | EFF_FLAG)],
            (0x17F, EFF_FLAG | 0x18FF_0100),
        ),
        ([(0x100 | INV_FILTER, SFF_MASK | FLAGS), (0x17F | INV_FILTER, SFF_MASK | FLAGS)], EVERY),
        # Told apart by EFF_FLAG, an identifier of 11 bits has no others.
        ([(0x1_2345, EFF_MASK | EFF_FLAG)], (0x345,)),
        ([(0x100, 0xFFFF_FFFF)], (0x100,)),
        ([(0, 0)], EVERY),
        ([(INV_FILTER, 0)], ()),
        ([], ()),
        (None, EVERY),
    ],
)
def test_what_comes_through(
    bus: Transport, filters: list[tuple[int, int]] | None, expected: tuple[int, ...]
) -> None:
    picky, other = bus.join(), bus.join()
    picky.set_filters(filters)
    bus.port.receive(frame_buffer(4))
    for can_id in EVERY:
        bus.port.send(batch([(can_id, b"")]), 1)
    other.send(batch([(can_id, b"") for can_id in EVERY]), len(EVERY))
    collect(bus.port, len(EVERY))
    picky.set_filters(None)
    bus.port.receive(frame_buffer(4))
    bus.port.send(batch([END]), 1)
    once = [can_id for can_id in EVERY if can_id in expected]
    got = collect_node(picky, 2 * len(once) + 1)
    assert got == [*((can_id, b"") for can_id in (*once, *once)), END]
    assert len(collect_node(other, len(EVERY) + 1)) == len(EVERY) + 1  # filters are a node's own


def test_as_many_as_the_kernel_takes_and_no_more(bus: Transport) -> None:
    node = bus.join()
    filters = [(can_id, SFF_MASK | FLAGS) for can_id in range(MOST_FILTERS)]
    node.set_filters(filters)
    bus.port.receive(frame_buffer(1024))
    bus.port.send(batch([(MOST_FILTERS, b""), (MOST_FILTERS - 1, b"")]), 2)
    assert collect_node(node, 1) == [(MOST_FILTERS - 1, b"")]
    with pytest.raises(InputError, match="513 filters"):
        node.set_filters([*filters, (0, 0)])
    node.close()
    with pytest.raises(BusError):
        node.set_filters(None)


@pytest.fixture(
    params=[pytest.param(open_inprocess, id="inprocess"), pytest.param(open_unix, id="unix")]
)
def user_space(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Transport]:
    opener: Opener = request.param
    transport = opener(tmp_path, "account")
    yield transport
    transport.close()


def test_what_a_node_does_not_want_is_no_loss_and_wakes_nobody(user_space: Transport) -> None:
    node = user_space.join()
    node.set_filters([(0x7FF, SFF_MASK | FLAGS)])
    rows = batch(numbered(256))
    for _ in range(20):
        assert user_space.port.receive(frame_buffer(4)) == 0
        user_space.port.send(rows, 256)
    assert node.receive(frame_buffer(4)) == 0
    user_space.port.send(batch([END]), 1)
    assert collect_node(node, 1) == [END]
    done = user_space.port.statistics
    assert (done.dropped, done.malformed, done.frames) == (0, 0, 20 * 256 + 1)


def test_the_barrier_passes_every_filter(user_space: Transport) -> None:
    node = user_space.join()
    node.set_filters([])
    BarrierSender().send(node, 5)
    receive_until_barrier(user_space)
    user_space.port.pop_barrier()
    user_space.port.send(batch(numbered(1)), 1)
    user_space.port.send_barrier(5)
    assert find_barrier(batch(collect_node(node, 1)), 1) == 0


def test_a_set_is_in_force_when_it_is_whole() -> None:
    port = InProcessPort("can0")
    node = port.connect()
    one = (0x100).to_bytes(4, "little") + (0x7FF).to_bytes(4, "little")
    node.send(batch([(FILTER_ID, one)]), 1)
    port.receive(frame_buffer(4))
    port.send(batch(numbered(1)), 1)
    assert collect_node(node, 1) == numbered(1)
    node.send(batch([(FILTER_ID, b"")]), 1)
    port.receive(frame_buffer(4))
    port.send(batch([*numbered(1), (0x100, b"")]), 2)
    assert collect_node(node, 1) == [(0x100, b"")]
    node.send(batch([(FILTER_ID, b"\1\2\3"), (ERR_FLAG | 1, b"")]), 2)
    port.receive(frame_buffer(4))
    assert port.statistics.malformed == 2


@pytest.mark.parametrize("opener", [fd_inprocess, fd_unix])
def test_fd_frames_are_filtered_by_identifier_too(opener: Opener, tmp_path: Path) -> None:
    bus = opener(tmp_path, "account")
    node = bus.join()
    node.set_filters([(0x101, SFF_MASK | FLAGS)])
    inbox = frame_buffer(8, FD_FRAME_SIZE)
    bus.port.receive(inbox)
    rows = frame_buffer(2, FD_FRAME_SIZE)
    for row, can_id in zip(rows, (0x100, 0x101), strict=True):
        row[:] = memoryview(pack_fd(can_id, bytes(range(64))))
    bus.port.send(rows, 2)
    assert node.receive(inbox) == 1
    assert inbox[0].tobytes() == rows[1].tobytes()
    bus.close()
