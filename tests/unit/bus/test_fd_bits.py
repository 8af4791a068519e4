"""Bits of CAN FD frames, against a frame written out bit by bit, and against hand-worked ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dftc_rt.bus.fd_bits import exact_fd_bits, fd_length, nominal_fd_bits, worst_fd_bits
from dftc_rt.bus.frame import (
    BRS,
    EFF_FLAG,
    ESI,
    FD_FRAME_SIZE,
    FD_LENGTHS,
    Frames,
    frame_buffer,
)


def frame(can_id: int, data: bytes, flags: int = BRS) -> Frames:
    rows = frame_buffer(1, FD_FRAME_SIZE)
    rows[0, :4] = np.frombuffer(can_id.to_bytes(4, "little"), dtype=np.uint8)
    rows[0, 4], rows[0, 5] = len(data), flags
    rows[0, 8 : 8 + len(data)] = np.frombuffer(data, dtype=np.uint8)
    return rows


def written_out(can_id: int, data: bytes, flags: int) -> tuple[int, int]:
    """The frame as a string of bits, the stuff bits as 'o' and 'i', the switch as '|'."""
    brs, esi = str(flags & BRS), str((flags & ESI) // ESI)
    if can_id & EFF_FLAG:
        plain = f"{can_id & 0x1FFFFFFF:029b}"
        head = "0" + plain[:11] + "11" + plain[11:] + "0" + "1" + "0" + brs
    else:
        head = "0" + f"{can_id:011b}" + "0" + "0" + "1" + "0" + brs
    body = esi + f"{FD_LENGTHS.index(len(data)):04b}" + "".join(f"{b:08b}" for b in data)
    wire, run = "", ""
    for position, bit in enumerate(head + body):
        if len(run) == 5:
            stuff = "i" if run[0] == "0" else "o"
            wire += stuff
            run = "1" if stuff == "i" else "0"
        if position == len(head):
            # The rate has changed within BRS: a stuff bit that follows it is short.
            held = wire[-1] if wire[-1] in "io" else ""
            wire = wire[: len(wire) - len(held)] + "|" + held
        wire += bit
        run = run + bit if run and run[0] == bit else bit
    crc = 21 if len(data) > 16 else 17
    field = "f"
    for k in range(4 + crc):
        field += "c"
        if k % 4 == 3:
            field += "f"
    slow, fast = wire.split("|")
    slow_bits = len(slow) + 1 + 1 + 1 + 7 + 3
    fast_bits = len(fast) + len(field)
    return (slow_bits, fast_bits) if flags & BRS else (slow_bits + fast_bits, 0)


@settings(max_examples=400, deadline=None)
@given(
    st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFF_FFFF).map(lambda i: i | EFF_FLAG)),
    st.sampled_from(FD_LENGTHS),
    st.sampled_from([0, BRS, BRS | ESI, ESI]),
    st.one_of(st.just(0), st.just(1), st.integers(2, 1 << 30)),
)
def test_against_the_frame_written_out(can_id: int, length: int, flags: int, seed: int) -> None:
    alike = bytes([255 * (seed & 1)]) * length
    data = alike if seed < 2 else np.random.default_rng(seed).bytes(length)
    exact = exact_fd_bits(frame(can_id, data, flags), 0)
    assert exact == written_out(can_id, data, flags)
    extended = bool(can_id & EFF_FLAG)
    least, most = nominal_fd_bits(length, extended), worst_fd_bits(length, extended)
    if flags & BRS:
        for rate in (1, 5, 8):
            time = exact[0] * rate + exact[1]
            assert least[0] * rate + least[1] <= time <= most[0] * rate + most[1]
    else:
        assert sum(least) <= exact[0] <= sum(most)


def test_hand_worked_frames() -> None:
    """Identifier 555h, no data: 0 10101010101 0 0 1 0 1 | 0 0000.

    No five equal bits before BRS. From ESI on there are five zeros, but they end the stuffed part,
    and a fixed stuff bit follows. Slow 17 + 13, fast 5 + 27.

    Identifier 000h, one byte 00h: 0 00000000000 0 0 1 0 1 | 0 0001 00000000. SOF and ten of the
    identifier's bits make 00000i 0000|... : of the 14 zeros up to IDE the 5th is followed by a
    stuff bit, after which nine are left: the 10th is followed by another. Then 0001 and eight
    zeros of data, of which the first five are followed by one. Slow 17 + 2 + 13, fast 13 + 1 + 27.
    """
    assert exact_fd_bits(frame(0x555, b""), 0) == (30, 32)
    assert exact_fd_bits(frame(0x000, b"\0"), 0) == (32, 41)


def test_the_data_rate_needs_the_flag() -> None:
    slow, fast = exact_fd_bits(frame(0x123, bytes(range(12))), 0)
    assert exact_fd_bits(frame(0x123, bytes(range(12)), 0), 0) == pytest.approx(
        (slow + fast, 0), abs=1
    )


@pytest.mark.parametrize(
    ("data_bytes", "expected"), [(0, 0), (8, 8), (9, 12), (17, 20), (33, 48), (49, 64), (64, 64)]
)
def test_lengths(data_bytes: int, expected: int) -> None:
    assert fd_length(data_bytes) == expected


@pytest.mark.parametrize(
    ("length", "extended", "slow", "fast"),
    [(0, False, 30, 32), (8, False, 30, 96), (16, False, 30, 160), (20, False, 30, 197),
     (64, True, 49, 549)],
)  # fmt: skip
def test_without_stuffing(length: int, extended: bool, slow: int, fast: int) -> None:
    """17 + 13 and 36 + 13; 5 + 8 n + 27, or 32 over 16 bytes."""
    assert nominal_fd_bits(length, extended) == (slow, fast)
