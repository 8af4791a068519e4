"""Every transport keeps these promises to its nodes and to the rig.

The transport ``vcan`` needs a kernel with AF_CAN; ``tests/uml/run.sh`` brings one.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.bus.barrier import BarrierSender, barrier_cycle, find_barrier
from dftc_rt.bus.frame import EFF_FLAG, RTR_FLAG, frame_buffer
from dftc_rt.bus.wait import wait
from dftc_rt.errors import BusError
from tests.conformance.bus_transports import (
    Opener,
    Transport,
    batch,
    collect,
    collect_node,
    numbered,
    open_inprocess,
    open_unix,
    open_vcan,
    receive_until_barrier,
)

BURST = 300  # more than a socket buffer of default size holds (278)


@pytest.fixture(
    params=[
        pytest.param(open_inprocess, id="inprocess"),
        pytest.param(open_unix, id="unix"),
        pytest.param(open_vcan, id="vcan", marks=pytest.mark.vcan),
    ]
)
def opener(request: pytest.FixtureRequest) -> Opener:
    chosen: Opener = request.param
    return chosen


@pytest.fixture
def bus(opener: Opener, tmp_path: Path) -> Iterator[Transport]:
    transport = opener(tmp_path, "account")
    yield transport
    transport.close()


def test_frames_keep_their_order_and_bytes_from_node_to_rig(bus: Transport) -> None:
    node = bus.join()
    sent = [
        (0x7FF, b""),
        (0x080, b"\x01"),
        (EFF_FLAG | 0x1ABC_DEF0, bytes(range(8))),
        (RTR_FLAG | 0x701, b""),
        (0x201, b"\x0f\x00\xff\x7f"),
    ]
    assert node.send(batch(sent), len(sent)) == len(sent)
    assert collect(bus.port, len(sent)) == sent


def test_frames_of_one_drive_keep_their_order_from_rig_to_node(bus: Transport) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4))
    sent = [(0x381, b"\x02"), (0x181, b"\x01"), (0x281, b"\x03")]
    bus.port.send(batch(sent), 3, np.zeros(3, dtype=np.int32))
    assert collect_node(node, 3) == sent


def test_the_lowest_identifier_of_several_drives_wins(bus: Transport) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4))
    sent = [(0x183, b"\x03"), (0x383, b"\x33"), (0x181, b"\x01"), (0x081, b"\x11")]
    bus.port.send(batch(sent), 4, np.array([3, 3, 1, 1], dtype=np.int32))
    assert collect_node(node, 4) == [sent[2], sent[3], sent[0], sent[1]]
    bus.port.send(batch(sent), 4)
    assert collect_node(node, 4) == [sent[3], sent[2], sent[0], sent[1]]


def test_a_burst_arrives_whole_and_in_order_when_it_is_read(bus: Transport) -> None:
    node = bus.join()
    sent = numbered(BURST)
    rows = batch(sent)
    got: list[tuple[int, bytes]] = []
    done = 0
    while done < BURST:
        accepted = node.send(rows[done:].copy(), BURST - done)
        got += collect(bus.port, accepted)
        done += accepted
        assert accepted > 0
    assert got == sent


def test_a_node_never_receives_its_own_frames(bus: Transport) -> None:
    node, other = bus.join(), bus.join()
    node.send(batch(numbered(5)), 5)
    collect(bus.port, 5)
    other.send(batch([(0x001, b"end")]), 1)
    collect(bus.port, 1)
    assert collect_node(node, 1) == [(0x001, b"end")]


def test_the_rig_never_receives_its_own_frames(bus: Transport) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4))
    bus.port.send(batch(numbered(5)), 5)
    node.send(batch([(0x001, b"end")]), 1)
    assert collect(bus.port, 1) == [(0x001, b"end")]


def test_every_other_node_sees_nodes_and_drives(bus: Transport) -> None:
    node, *others = [bus.join() for _ in range(4)]
    sent = numbered(3)
    node.send(batch(sent), 3)
    collect(bus.port, 3)
    bus.port.send(batch([(0x181, b"drive")]), 1)
    for other in others:
        assert collect_node(other, 4) == [*sent, (0x181, b"drive")]
    assert collect_node(node, 1) == [(0x181, b"drive")]


def test_receive_never_blocks(bus: Transport) -> None:
    buffer = frame_buffer(4)
    assert bus.port.receive(buffer) == 0
    node = bus.join()
    assert node.receive(buffer) == 0
    assert bus.port.receive(buffer) == 0


def test_a_waiting_frame_is_worth_waking_for(bus: Transport) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4))
    assert wait([node], 0.0) == (node.fd < 0)
    bus.port.send(batch(numbered(1)), 1)
    assert wait([node], 5.0)


def test_a_closed_node_raises(bus: Transport) -> None:
    node = bus.join()
    node.close()
    node.close()
    with pytest.raises(BusError):
        node.receive(frame_buffer(4))
    with pytest.raises(BusError):
        node.send(batch(numbered(1)), 1)


def test_a_barrier_stops_receive_behind_what_was_sent_before_it(bus: Transport) -> None:
    node = bus.join()
    barriers = BarrierSender()
    node.send(batch(numbered(3)), 3)
    assert barriers.send(node, 2**40 + 7)
    node.send(batch([(0x080, b"next")]), 1)
    assert collect(bus.port, 3) == numbered(3)
    receive_until_barrier(bus)
    assert bus.port.receive(frame_buffer(4)) == 0
    assert bus.port.pop_barrier() == 2**40 + 7
    assert not bus.port.barrier_pending
    assert bus.port.pop_barrier() is None
    assert collect(bus.port, 1) == [(0x080, b"next")]
    assert bus.port.statistics.frames == 4


def test_the_answer_to_a_barrier_comes_behind_the_answers(bus: Transport) -> None:
    node = bus.join()
    for cycle in range(3):
        BarrierSender().send(node, cycle)
        receive_until_barrier(bus)
        assert bus.port.pop_barrier() == cycle
        bus.port.send(batch(numbered(2)), 2)
        bus.port.send_barrier(cycle)
        collected = collect_node(node, 3)
        rows = batch(collected)
        assert collected[:2] == numbered(2)
        assert find_barrier(rows, 3) == 2
        assert barrier_cycle(rows, 2) == cycle
    with pytest.raises(RuntimeError):
        bus.port.send_barrier(3)


def test_bits_on_the_wire_are_counted(bus: Transport) -> None:
    node = bus.join()
    node.send(batch([(0x080, b"")]), 1)
    collect(bus.port, 1)
    bus.port.send(batch([(0x181, bytes(8))]), 1)
    statistics = bus.port.statistics
    assert statistics.frames == 2
    assert statistics.nominal_bits == 47 + 111
    assert statistics.worst_bits == 55 + 135
    assert statistics.nominal_bits < statistics.exact_bits <= statistics.worst_bits
    assert statistics.busy_s == statistics.exact_bits / 1_000_000
    assert statistics.load(1e-3) == statistics.exact_bits / 1_000


def test_there_is_one_order_on_the_wire(bus: Transport) -> None:
    first, second, listener = bus.join(), bus.join(), bus.join()
    first.send(batch([(0x300, b"a"), (0x100, b"b")]), 2)
    second.send(batch([(0x200, b"c"), (0x400, b"d")]), 2)
    wire = collect(bus.port, 4)
    assert collect_node(listener, 4) == wire
    assert collect_node(first, 2) == [frame for frame in wire if frame[1] in (b"c", b"d")]
    assert collect_node(second, 2) == [frame for frame in wire if frame[1] in (b"a", b"b")]


def test_a_node_that_leaves_is_no_error_and_its_last_frames_count(bus: Transport) -> None:
    leaving, staying = bus.join(), bus.join()
    bus.port.receive(frame_buffer(4))
    bus.port.send(batch(numbered(2, 0x181)), 2)  # never read by the node that leaves
    leaving.send(batch(numbered(3)), 3)
    leaving.close()
    assert collect(bus.port, 3) == numbered(3)
    bus.port.receive(frame_buffer(4))
    bus.port.send(batch([(0x182, b"on")]), 1)
    assert collect_node(staying, 6) == [*numbered(2, 0x181), *numbered(3), (0x182, b"on")]
