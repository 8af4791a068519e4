"""Promises of the buses that the rig itself carries: it arbitrates, forwards and counts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.bus.barrier import BarrierSender, find_barrier
from dftc_rt.bus.frame import frame_buffer
from dftc_rt.errors import BusError, InputError
from hil.bus.inprocess import InProcessPort
from tests.conformance.bus_transports import (
    Opener,
    Transport,
    batch,
    collect,
    collect_node,
    contents,
    numbered,
    open_inprocess,
    open_unix,
)


@pytest.fixture(
    params=[pytest.param(open_inprocess, id="inprocess"), pytest.param(open_unix, id="unix")]
)
def opener(request: pytest.FixtureRequest) -> Opener:
    chosen: Opener = request.param
    return chosen


@pytest.fixture
def bus(opener: Opener, tmp_path: Path) -> Iterator[Transport]:
    transport = opener(tmp_path, "account")
    yield transport
    transport.close()


def test_send_never_blocks_and_says_how_many_were_accepted(bus: Transport) -> None:
    node = bus.join()
    rows = batch(numbered(256))
    accepted = total = node.send(rows, 256)
    while accepted == 256:
        accepted = node.send(rows, 256)
        total += accepted
    assert node.send(rows, 256) == 0
    got = collect(bus.port, total)
    assert len(got) == total
    assert node.send(rows, 1) == 1


def test_a_slow_node_loses_alone_and_is_counted(bus: Transport) -> None:
    slow, quick = bus.join(), bus.join()
    bus.port.receive(frame_buffer(4))
    rows = batch(numbered(64))
    sent = 0
    while not bus.port.statistics.dropped:
        bus.port.send(rows, 64)
        sent += 64
        assert collect_node(quick, 64) == numbered(64)
    held = collect_node(slow, sent - bus.port.statistics.dropped)
    assert len(held) == sent - bus.port.statistics.dropped
    assert held == (numbered(64) * (sent // 64))[: len(held)]
    bus.port.send(batch([(0x001, b"end")]), 1)
    assert collect_node(slow, 1) == collect_node(quick, 1) == [(0x001, b"end")]


def test_a_closed_bus_raises_at_its_nodes(bus: Transport) -> None:
    node = bus.join()
    bus.port.receive(frame_buffer(4))
    bus.port.close()
    with pytest.raises(BusError, match="can0"):
        node.receive(frame_buffer(4))
    with pytest.raises(BusError, match="can0"):
        node.send(batch(numbered(1)), 1)


def test_barriers_stay_between_the_rig_and_their_node(bus: Transport) -> None:
    node, listener = bus.join(), bus.join()
    BarrierSender().send(node, 1)
    listener.send(batch([(0x300, b"x")]), 1)
    assert collect(bus.port, 1) == [(0x300, b"x")]
    assert bus.port.pop_barrier() == 1
    bus.port.send_barrier(1)
    bus.port.send(batch([(0x181, b"y")]), 1)
    assert collect_node(listener, 1) == [(0x181, b"y")]
    frames = batch(collect_node(node, 3))
    assert find_barrier(frames, 3) == 1


def test_one_nodes_barrier_does_not_hold_the_others(bus: Transport) -> None:
    node, other = bus.join(), bus.join()
    BarrierSender().send(node, 5)
    node.send(batch([(0x100, b"held")]), 1)
    other.send(batch(numbered(2)), 2)
    assert collect(bus.port, 2) == numbered(2)
    assert bus.port.barrier_pending
    other.send(batch(numbered(2)), 2)
    assert collect(bus.port, 2) == numbered(2)
    assert bus.port.pop_barrier() == 5
    assert collect(bus.port, 1) == [(0x100, b"held")]


def test_nodes_contend_and_each_keeps_its_own_order(bus: Transport) -> None:
    first, second = bus.join(), bus.join()
    first.send(batch([(0x300, b"a"), (0x100, b"b")]), 2)
    second.send(batch([(0x200, b"c"), (0x400, b"d")]), 2)
    assert collect(bus.port, 4) == [(0x200, b"c"), (0x300, b"a"), (0x100, b"b"), (0x400, b"d")]


def test_timing_off_keeps_the_order_of_sending(opener: Opener, tmp_path: Path) -> None:
    bus = opener(tmp_path, "off")
    node = bus.join()
    bus.port.receive(frame_buffer(4))
    sent = [(0x183, b"\x03"), (0x181, b"\x01")]
    bus.port.send(batch(sent), 2)
    assert collect_node(node, 2) == sent
    assert bus.port.statistics.frames == 2
    assert bus.port.statistics.exact_bits == 0
    bus.close()


def test_nodes_are_counted_as_they_come_and_go(bus: Transport) -> None:
    leaving = bus.join()
    bus.join()
    version = bus.port.fds_version
    bus.port.receive(frame_buffer(4))
    assert bus.port.statistics.clients == 2
    leaving.close()
    bus.port.receive(frame_buffer(4))
    assert bus.port.statistics.clients == 1
    assert bus.port.statistics.departed == 1
    assert bus.port.fds_version > version


def test_a_small_receive_buffer_loses_nothing(bus: Transport) -> None:
    first, second = bus.join(), bus.join()
    first.send(batch(numbered(5, 0x100)), 5)
    second.send(batch(numbered(5, 0x200)), 5)
    buffer = frame_buffer(3)
    got: list[tuple[int, bytes]] = []
    while len(got) < 10:
        count = bus.port.receive(buffer)
        assert 0 < count <= 3
        got += contents(buffer, count)
    assert got == numbered(5, 0x100) + numbered(5, 0x200)


def test_records_that_are_no_frames_are_left_out_and_counted(bus: Transport) -> None:
    node = bus.join()
    rows = batch(numbered(3))
    rows[1, 4] = 9  # more data than a classical frame holds
    node.send(rows, 3)
    assert collect(bus.port, 2) == [numbered(3)[0], numbered(3)[2]]
    assert bus.port.statistics.malformed == 1


def test_both_transports_behave_alike_bit_for_bit(tmp_path: Path) -> None:
    """The same traffic, seen by the rig, by the nodes and in the statistics."""

    def record(opener: Opener) -> list[object]:
        bus = opener(tmp_path, "account")
        nodes = [bus.join() for _ in range(3)]
        generator = np.random.default_rng(4)
        seen: list[object] = []
        buffer = frame_buffer(7)
        for cycle in range(50):
            for node in nodes:
                ids = generator.integers(0, 0x800, size=generator.integers(0, 6))
                frames = [(int(can_id), generator.bytes(8)) for can_id in ids]
                node.send(batch(frames), len(frames))
            BarrierSender().send(nodes[0], cycle)
            while not bus.port.barrier_pending:
                seen.append(contents(buffer, bus.port.receive(buffer)))
            seen.append(bus.port.pop_barrier())
            answers = batch([(int(i), bytes([cycle])) for i in generator.integers(0, 0x800, 5)])
            bus.port.send(answers, 5, generator.integers(0, 3, 5, dtype=np.int32))
            bus.port.send_barrier(cycle)
            seen += [contents(buffer, node.receive(buffer)) for node in nodes]
        seen.append(bus.port.statistics)
        bus.close()
        return seen

    assert record(open_inprocess) == record(open_unix)


def test_a_timing_that_this_bus_does_not_keep_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"bus\.timing"):
        InProcessPort("can0", timing="pace")  # type: ignore[arg-type]


@pytest.mark.parametrize("others", [0, 1])
def test_a_barrier_is_seen_with_the_frames_before_it(bus: Transport, others: int) -> None:
    node, *_ = [bus.join() for _ in range(1 + others)]
    node.send(batch(numbered(3)), 3)
    BarrierSender().send(node, 9)
    assert bus.port.receive(frame_buffer(8)) == 3
    assert bus.port.barrier_pending


def test_a_node_that_leaves_at_its_barrier_is_not_answered(bus: Transport) -> None:
    leaving, staying = bus.join(), bus.join()
    BarrierSender().send(leaving, 1)
    bus.port.receive(frame_buffer(4))
    assert bus.port.pop_barrier() == 1
    leaving.close()
    bus.port.receive(frame_buffer(4))
    bus.port.send_barrier(1)
    assert staying.receive(frame_buffer(4)) == 0
    assert bus.port.statistics.departed == 1


def test_a_node_without_room_for_its_barrier_is_disconnected() -> None:
    port = InProcessPort("can0")
    node = port.connect(capacity=2)
    BarrierSender().send(node, 1)
    port.receive(frame_buffer(4))
    assert port.pop_barrier() == 1
    port.send(batch(numbered(2)), 2)
    port.send_barrier(1)
    assert collect_node(node, 2) == numbered(2)
    with pytest.raises(BusError):
        node.receive(frame_buffer(4))


def test_a_closed_bus_leaves_no_socket_file(tmp_path: Path) -> None:
    bus = open_unix(tmp_path)
    assert (tmp_path / "buses" / "can0").is_socket()
    bus.port.close()
    bus.port.close()
    assert not (tmp_path / "buses" / "can0").exists()
    bus.close()


@pytest.mark.parametrize("stuck", [0, 1])
def test_many_frames_reach_every_node_that_reads_and_cost_the_stuck_one_alone(
    bus: Transport, stuck: int
) -> None:
    sender, receiver, *listeners = [bus.join() for _ in range(4)]
    never_reads = [bus.join() for _ in range(stuck)]
    count, burst = 20_000, 20
    sent = numbered(count)
    inbox = frame_buffer(512)
    heard: list[list[bytes]] = [[], [], []]
    for first in range(0, count, burst):
        assert sender.send(batch(sent[first : first + burst]), burst) == burst
        assert bus.port.receive(inbox) == burst
        for node, mine in zip((receiver, *listeners), heard, strict=True):
            got = node.receive(inbox)
            mine += [inbox[row, 8:16].tobytes() for row in range(got)]
    assert heard == [[data for _, data in sent]] * 3
    done = bus.port.statistics
    assert done.frames == count
    if not stuck:
        assert done.dropped == 0
        return
    held = 0
    while fresh := never_reads[0].receive(inbox):
        held += fresh
    assert done.dropped == count - held > 0


def test_more_than_fits_the_buffer_is_had_by_calling_again(bus: Transport) -> None:
    node = bus.join()
    assert node.send(batch(numbered(200)), 200) == 200
    inbox = frame_buffer(64)
    bus.join()  # with two nodes, frames wait in the bus once they are read
    assert [bus.port.receive(inbox) for _ in range(5)] == [64, 64, 64, 8, 0]
