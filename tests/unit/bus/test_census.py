"""What came over a bus: periods, jitter, time on the wire."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.bus.bits import exact_bits
from dftc_rt.bus.census import Census
from dftc_rt.bus.frame import EFF_FLAG, ERR_FLAG, FD_FRAME_SIZE, frame_buffer, pack, pack_fd


def rows(*raws: bytes, size: int = 16) -> np.ndarray:
    frames = frame_buffer(len(raws), size)
    for row, raw in enumerate(raws):
        frames[row, : len(raw)] = np.frombuffer(raw, dtype=np.uint8)
    return frames


def test_period_jitter_and_the_last_data() -> None:
    census = Census(1_000_000)
    frames = rows(*(pack(0x181, bytes([k, 0])) for k in range(4)))
    census.take(frames, 4, [10.000, 10.001, 10.003, 10.004])
    seen = census.seen[0x181]
    assert (seen.frames, seen.length, seen.data, seen.name) == (4, 2, b"\x03\0", "0x181")
    assert seen.period_s == pytest.approx(4e-3 / 3)
    assert seen.jitter_s == pytest.approx(1e-3)


def test_one_frame_has_no_period_and_two_have_no_jitter() -> None:
    census = Census(1_000_000)
    census.take(rows(pack(EFF_FLAG | 0x123, b"")), 1, [1.0])
    seen = census.seen[EFF_FLAG | 0x123]
    assert (seen.period_s, seen.jitter_s, seen.name) == (None, None, "0x00000123")
    census.take(rows(pack(EFF_FLAG | 0x123, b"")), 1, [1.5])
    assert (seen.period_s, seen.jitter_s) == (0.5, None)


def test_time_on_the_wire_is_that_of_the_bits() -> None:
    census = Census(500_000)
    frames = rows(pack(0x0, bytes(8)), pack(0x7FF, b"\x55" * 8))
    census.take(frames, 2, [0.0, 0.0])
    bits = exact_bits(frames, 0) + exact_bits(frames, 1)
    assert census.bit_s == pytest.approx(bits / 500_000)
    # 11-bit identifier 0, 8 bytes of 0: 111 bits, and a stuff bit in every run of zeros
    assert census.seen[0].bit_s > 111 / 500_000


def test_can_fd_has_two_rates() -> None:
    slow, fast = Census(1_000_000, 1_000_000), Census(1_000_000, 5_000_000)
    frames = rows(pack_fd(0x101, b"\x55" * 48), pack(0x102, b"a"), size=FD_FRAME_SIZE)
    for census in (slow, fast):
        census.take(frames, 2, [0.0, 0.0])
    assert slow.seen[0x102].bit_s == fast.seen[0x102].bit_s
    assert slow.seen[0x101].bit_s > 3.0 * fast.seen[0x101].bit_s
    assert fast.seen[0x101].length == 48


def test_error_frames_are_no_traffic() -> None:
    census = Census(1_000_000)
    census.take(rows(pack(ERR_FLAG | 0x40, bytes(8)), pack(0x80, b"")), 2, [0.0, 0.0])
    assert census.frames == 1
    assert census.errors.state == "bus-off"
    assert list(census.seen) == [0x80]
