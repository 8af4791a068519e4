"""Bits on the wire: frames worked by hand, and an independent way to the same number."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.bus.bits import charge, exact_bits, nominal_bits, worst_bits
from dftc_rt.bus.frame import EFF_FLAG, RTR_FLAG, Frames, frame_buffer, pack


def one(can_id: int, data: bytes) -> Frames:
    frames = frame_buffer(1)
    frames[0] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    return frames


# SOF, identifier, RTR IDE r0, DLC | data | CRC, with the stuff bits in brackets; then 13 bits.
# CRC of SYNC: its one 1 is x^14, times x^15 is x^29; x^15 = 0x4599, x^16 = 0x4EAB, x^17 = 0x58CF,
# x^18 = 0x7407, 0x2D97, 0x5B2E, 0x73C5, 0x2213, 0x4426, 0x4DD5, 0x5E33, 0x79FF, 0x3667, 0x6CCE,
# x^29 = 0x1C05 = 001110000000101.
# An all-dominant header has remainder 0, so the whole frame is 34 zeros: 6 stuff bits.
@pytest.mark.parametrize(
    ("can_id", "data", "wire"),
    [
        (0x080, b"", "0000100000(1)00000(1)00000(1)011100000(1)00101"),
        (0x000, b"", "00000(1)00000(1)00000(1)00000(1)00000(1)00000(1)0000"),
        (
            EFF_FLAG,
            b"",
            "00000(1)00000(1)001100000(1)00000(1)00000(1)00000(1)00000(1)100011000010000",
        ),
        (
            0x7FF,
            b"\xff" * 8,
            "0" + 2 * "11111(0)" + "10001000" + 13 * "11111(0)" + "00110010001001",
        ),
    ],
)
def test_frames_worked_by_hand(can_id: int, data: bytes, wire: str) -> None:
    assert exact_bits(one(can_id, data), 0) == len(wire.replace("(", "").replace(")", "")) + 13


def stuffed_length(can_id: int, data: bytes) -> int:
    """Count by polynomial division and a string of bits, as the standard is written."""
    remote = "1" if can_id & RTR_FLAG else "0"
    if can_id & EFF_FLAG:
        identifier = format(can_id & 0x1FFF_FFFF, "029b")
        header = "0" + identifier[:11] + "11" + identifier[11:] + remote + "00"
    else:
        header = "0" + format(can_id & 0x7FF, "011b") + remote + "00"
    payload = b"" if can_id & RTR_FLAG else data
    bits = header + format(len(data), "04b") + "".join(format(byte, "08b") for byte in payload)
    remainder = int(bits, 2) << 15
    while remainder.bit_length() > 15:
        remainder ^= 0xC599 << (remainder.bit_length() - 16)
    bits += format(remainder, "015b")
    wire = ""
    for bit in bits:
        wire += bit
        if wire[-5:] in ("00000", "11111") and len(wire) >= 5:
            wire += "1" if bit == "0" else "0"
    return len(wire) + len("1111111111111")


identifiers = st.one_of(
    st.integers(0, 0x7FF),
    st.integers(0, 0x1FFF_FFFF).map(lambda can_id: can_id | EFF_FLAG),
    st.integers(0, 0x7FF).map(lambda can_id: can_id | RTR_FLAG),
    st.sampled_from([0, 0x7FF, EFF_FLAG, EFF_FLAG | 0x1FFF_FFFF, 0x0F8, 0x707]),
)
payloads = st.one_of(
    st.binary(max_size=8),
    st.lists(st.sampled_from([0x00, 0xFF, 0x1F, 0xE0, 0x83, 0x0F]), max_size=8).map(bytes),
)


@given(identifiers, payloads)
def test_exact_bits_agree_with_an_independent_count(can_id: int, data: bytes) -> None:
    assert exact_bits(one(can_id, data), 0) == stuffed_length(can_id, data)


@given(identifiers, payloads)
def test_exact_lies_between_nominal_and_worst(can_id: int, data: bytes) -> None:
    extended = bool(can_id & EFF_FLAG)
    on_wire = 0 if can_id & RTR_FLAG else len(data)
    bits = exact_bits(one(can_id, data), 0)
    assert nominal_bits(on_wire, extended) <= bits <= worst_bits(on_wire, extended)


def test_lengths_of_the_literature() -> None:
    # Davis, Burns, Bril, Lukkien (2007), "Controller Area Network schedulability analysis:
    # refuted, revisited and revised": an 8-byte frame takes at most 135 bits with an 11-bit
    # identifier, 160 with 29 bits; in general 55 + 10 n and 80 + 10 n.
    for length in range(9):
        assert worst_bits(length) == 55 + 10 * length
        assert worst_bits(length, extended=True) == 80 + 10 * length
    assert [nominal_bits(length) for length in (0, 4, 8)] == [47, 79, 111]
    assert nominal_bits(8, extended=True) == 131


def test_charge_adds_up() -> None:
    frames = frame_buffer(3)
    sent = [(0x080, b""), (EFF_FLAG | 0x1234_5678, b"abc"), (RTR_FLAG | 0x701, bytes(8))]
    for row, (can_id, data) in enumerate(sent):
        frames[row] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    totals = np.array([10, 0, 0, 0], dtype=np.int64)
    latency = np.zeros(2048)
    charge(frames, 3, totals, 1e-6, latency)
    bits = [exact_bits(frames, row) for row in range(3)]
    for row in range(3):
        number = int.from_bytes(frames[row, :4].tobytes(), "little")
        if not number & EFF_FLAG:
            assert latency[number & 0x7FF] == pytest.approx(1e-6 * sum(bits[: row + 1]))
    assert (latency > 0).sum() >= 1
    assert totals[0] == 13
    assert totals[1] == 47 + (67 + 24) + 47
    assert totals[2] == sum(stuffed_length(can_id, data) for can_id, data in sent)
    assert totals[3] == 55 + (80 + 30) + 55
