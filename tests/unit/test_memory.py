"""Records in memory: nothing lost or reordered at the edges of blocks."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.memory import MemorySink

BLOCK = 4096


def fill(sink: MemorySink, first: int, count: int) -> None:
    for k in range(first, first + count):
        sink.slot()[:] = (k, -k)
        sink.commit()


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK + 7])
def test_all_records_in_order(count: int) -> None:
    sink = MemorySink(2)
    fill(sink, 0, count)
    assert len(sink) == count
    records = sink.records()
    assert records.shape == (count, 2)
    assert np.array_equal(records[:, 0], np.arange(count))
    assert np.array_equal(records[:, 1], -np.arange(count))


def test_slot_is_not_a_record_before_its_commit() -> None:
    sink = MemorySink(2)
    sink.slot()[:] = 5.0
    sink.slot()[:] = 6.0
    assert len(sink) == 0
    assert sink.commit()
    assert sink.records().tolist() == [[6.0, 6.0]]


def test_drain_hands_on_each_record_once() -> None:
    sink = MemorySink(2)
    seen: list[float] = []
    for first in range(0, 3 * BLOCK, 1000):
        fill(sink, first, 1000)
        while len(block := sink.drain()):
            seen += block[:, 0].tolist()
    assert seen == list(range(len(sink)))
    assert len(sink.drain()) == 0
