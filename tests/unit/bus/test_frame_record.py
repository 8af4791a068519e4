"""A frame as a record: bytes by hand."""

from __future__ import annotations

import numpy as np

from dftc_rt.bus.barrier import write_barrier
from dftc_rt.bus.frame import BRS, EFF_FLAG, RTR_FLAG, frame_buffer, pack, pack_fd
from dftc_rt.bus.frame_record import RecordBatch, frames_of, record_dtype, record_words


def test_classical_record_by_hand() -> None:
    frames = frame_buffer(2)
    frames[0] = np.frombuffer(pack(0x205, b"\x0f\x00\x34\x12"), np.uint8)
    frames[0, 12:] = 0xEE  # behind the data: what was in the buffer before
    batch = RecordBatch(4, 8, barriers=True)
    assert batch.fill(frames, 1, 0.25, 2, tx=True) == 1
    expected = "000000000000d03f05020000020100040f00341200000000"
    assert batch.words[0].tobytes().hex() == expected
    assert record_words(8) * 8 == len(expected) // 2


def test_fd_record_by_hand() -> None:
    frames = frame_buffer(2, 72)
    frames[0] = np.frombuffer(pack_fd(EFF_FLAG | 0x8001, bytes(range(12)), BRS), np.uint8)
    frames[1, :16] = np.frombuffer(pack(0x81, b"\x01"), np.uint8)
    batch = RecordBatch(4, 64, barriers=True)
    assert batch.fill(frames, 2, -1.0, 0, tx=False) == 2
    head = "000000000000f0bf018000800000050c"
    data = bytes(range(12)) + bytes(52)
    assert batch.words[0].tobytes().hex() == head + data.hex()
    classical = "000000000000f0bf810000000000000101"
    assert batch.words[1].tobytes().hex() == classical + "00" * 63


def test_barriers_are_left_out_in_lockstep_alone() -> None:
    frames = frame_buffer(3)
    for row, can_id in ((0, 0x80), (2, 0x181)):
        frames[row] = np.frombuffer(pack(can_id, b"\x07"), np.uint8)
    write_barrier(frames, 1, 77)
    without = RecordBatch(4, 8, barriers=False)
    assert without.fill(frames, 3, 0.0, 0, tx=True) == 2
    assert without.words[:2].view(record_dtype(8))["id"].ravel().tolist() == [0x80, 0x181]
    assert RecordBatch(4, 8, barriers=True).fill(frames, 3, 0.0, 0, tx=True) == 3


def test_records_become_the_frames_they_were() -> None:
    frames = frame_buffer(3, 72)
    frames[0] = np.frombuffer(pack_fd(0x123, bytes(range(64)), BRS), np.uint8)
    frames[1, :16] = np.frombuffer(pack(RTR_FLAG | 0x701, b""), np.uint8)
    frames[2, :16] = np.frombuffer(pack(0x7FF, b"12345678"), np.uint8)
    batch = RecordBatch(3, 64, barriers=True)
    batch.fill(frames, 3, 0.0, 0, tx=True)
    records = batch.words.view(record_dtype(64))[:, 0]
    np.testing.assert_array_equal(frames_of(records, 72), frames)
    np.testing.assert_array_equal(frames_of(records[1:], 16), frames[1:, :16])
