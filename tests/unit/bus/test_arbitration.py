"""Arbitration: the key orders as the wire does, and queues keep their order."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.bus.frame import EFF_FLAG, RTR_FLAG, Frames, frame_buffer, pack
from hil.bus.arbitration import arbitrate, arbitration_key, is_ordered, order_by_identifier

identifiers = st.one_of(
    st.sampled_from([0x100, 0x101, EFF_FLAG | 0x100 << 18, RTR_FLAG | 0x100]),
    st.integers(0, 0x7FF),
    st.integers(0, 0x1FFF_FFFF).map(lambda can_id: can_id | EFF_FLAG),
)
queues = st.lists(st.tuples(identifiers, st.integers(0, 3)), max_size=20)


def batch(ids: list[int]) -> Frames:
    frames = frame_buffer(max(len(ids), 1))
    for row, can_id in enumerate(ids):
        frames[row] = np.frombuffer(pack(can_id, b""), dtype=np.uint8)
    return frames


def wire_field(can_id: int) -> str:
    """The arbitration field, bit by bit; dominant is 0 and wins."""
    remote = "1" if can_id & RTR_FLAG else "0"
    if can_id & EFF_FLAG:
        bits = format(can_id & 0x1FFF_FFFF, "029b")
        return bits[:11] + "11" + bits[11:] + remote
    return format(can_id & 0x7FF, "011b") + remote + "0"


def test_data_beats_remote_beats_long_of_the_same_beginning() -> None:
    frames = batch([0x123, RTR_FLAG | 0x123, EFF_FLAG | 0x123 << 18, 0x124])
    keys = [arbitration_key(frames, row) for row in range(4)]
    assert keys == sorted(set(keys))


@given(identifiers, identifiers)
def test_the_key_orders_as_the_bits_on_the_wire(one: int, other: int) -> None:
    frames = batch([one, other])
    by_key = arbitration_key(frames, 0) < arbitration_key(frames, 1)
    assert by_key == (wire_field(one) < wire_field(other))


@given(queues)
def test_arbitration_is_what_a_bus_of_queues_does(sent: list[tuple[int, int]]) -> None:
    waiting: dict[int, list[int]] = {}
    for row, (_, node) in enumerate(sent):
        waiting.setdefault(node, []).append(row)
    expected = []
    while any(waiting.values()):
        heads = [queue[0] for queue in waiting.values() if queue]
        winner = min(heads, key=lambda row: (wire_field(sent[row][0]), row))
        waiting[sent[winner][1]].pop(0)
        expected.append(winner)
    order = np.full(len(sent), -1, dtype=np.int64)
    nodes = np.array([node for _, node in sent], dtype=np.int32)
    arbitrate(batch([can_id for can_id, _ in sent]), nodes, len(sent), order)
    assert order.tolist() == expected


@given(st.lists(identifiers, max_size=20))
def test_ordering_by_identifier_is_a_stable_sort(ids: list[int]) -> None:
    frames = batch(ids)
    order = np.full(len(ids), -1, dtype=np.int64)
    order_by_identifier(frames, len(ids), order)
    expected = sorted(range(len(ids)), key=lambda row: wire_field(ids[row]))
    assert order.tolist() == expected
    assert is_ordered(frames, len(ids)) == (expected == list(range(len(ids))))
