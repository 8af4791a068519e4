"""Frames of the MIT protocol against bytes worked out by hand from its publication.

float_to_uint(x, min, max, bits) = (int)((x - min) * (2^bits - 1) / (max - min)), with the
published ranges ±12.5 rad, ±45 rad/s, 0 to 500 Nm/rad, 0 to 5 Nm s/rad, ±18 Nm.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.bus.frame import frame_buffer, pack, unpack
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.mit import codec
from dftc_rt.drives.mit.scale import wire_table
from tests.unit.drives.mit.mit_bus import scales

NODES = np.array([1, 2, 5])
MEMBERS = np.arange(3)
WIRE = wire_table(scales(3))
LOOKUP = np.full(256, -1, dtype=np.int32)
LOOKUP[NODES] = MEMBERS
READY = int(states.STATE_BITS[states.SWITCHED_ON])
ENABLED = int(states.STATE_BITS[states.OPERATION_ENABLED])


def decode(*frames: tuple[int, bytes], words=None, wire=WIRE, host=0):
    values = np.zeros((codec.F_ROWS, 3))
    if words is None:
        words = np.zeros((codec.W_ROWS, 3), dtype=np.int64)
    other = np.full(16, 9, dtype=np.uint8)
    batch = frame_buffer(16)
    for row, (can_id, data) in enumerate(frames):
        batch[row] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    marked = codec.decode_answers(batch, len(frames), host, LOOKUP, wire, values, words, other)
    return values, words, other[: len(frames)].tolist(), marked


def test_command_bytes() -> None:
    # p = 1 rad:      (1 + 12.5) · 65535 / 25  = 35388.9   -> 35388 = 8A3Ch
    # v = -2 rad/s:   (-2 + 45) · 4095 / 90    = 1956.5    -> 1956  = 7A4h
    # kp = 100:       100 · 4095 / 500         = 819               = 333h
    # kd = 1.5:       1.5 · 4095 / 5           = 1228.5    -> 1228  = 4CCh
    # t = 6 Nm:       (6 + 18) · 4095 / 36     = 2730              = AAAh
    # Packed: 8A 3C | 7A | 4 3 | 33 | 4C | C A | AA. Identifier: node 5, 8 bytes.
    codes = [
        codec.float_to_uint(1.0, -12.5, 12.5, 16),
        codec.float_to_uint(-2.0, -45.0, 45.0, 12),
        codec.float_to_uint(100.0, 0.0, 500.0, 12),
        codec.float_to_uint(1.5, 0.0, 5.0, 12),
        codec.float_to_uint(6.0, -18.0, 18.0, 12),
    ]
    assert codes == [35388, 1956, 819, 1228, 2730]
    frames = frame_buffer(3)
    assert codec.encode_command(frames, 1, 5, *codes) == 2
    assert bytes(frames[1]).hex(" ") == "05 00 00 00 08 00 00 00 8a 3c 7a 43 33 4c ca aa"
    assert not frames[0].any()
    back = np.zeros(5, dtype=np.int64)
    codec.decode_command(frames, 1, back)
    assert back.tolist() == codes


def test_zero_torque_is_the_frame_of_the_publication() -> None:
    # 0 in every field: 0.5 · 65535 = 32767.5 -> 7FFFh; 0.5 · 4095 = 2047.5 -> 7FFh; gains 0.
    # Packed: 7F FF | 7F | F 0 | 00 | 00 | 0 7 | FF.
    frames = frame_buffer(1)
    asked, torque = np.array([codec.TORQUE]), np.array([codec.T_ZERO])
    codec.encode_cycle(frames, 0, np.array([0]), np.array([2]), asked, torque)
    assert unpack(frames[0]) == (2, bytes.fromhex("7fff7ff0000007ff"))


@pytest.mark.parametrize(
    ("what", "last"), [(codec.ENTER, "fc"), (codec.LEAVE, "fd"), (codec.ZERO_HERE, "fe")]
)
def test_special_bytes(what: int, last: str) -> None:
    frames = frame_buffer(1)
    assert codec.encode_special(frames, 0, 3, what) == 1
    assert bytes(frames[0]).hex() == "03000000" + "08000000" + "ff" * 7 + last
    assert codec.special(frames, 0) == what


@pytest.mark.parametrize(
    "data", ["ff" * 8, "ff" * 7 + "fb", "fe" + "ff" * 6 + "fc", "7fff7ff0000007ff"]
)
def test_other_frames_are_not_special(data: str) -> None:
    frames = frame_buffer(1)
    frames[0] = np.frombuffer(pack(3, bytes.fromhex(data)), dtype=np.uint8)
    assert codec.special(frames, 0) == 0


def test_answer_bytes() -> None:
    # Node 2; p = 8A3Ch, v = 7A4h, t = AAAh: 02 | 8A 3C | 7A | 4 A | AA.
    # A drive cuts off, so what it has is, in the middle of the code:
    #   p = 35388.5 · 25 / 65535 − 12.5 = 884712.5 / 65535 − 12.5 = 1 − 10 / 65535,
    #   v = 1956.5 · 90 / 4095 − 45 = 43 − 45, t = 2730.5 · 36 / 4095 − 18 = 6 + 18 / 4095.
    frames = frame_buffer(1)
    codec.encode_answer(frames, 0, 0, 6, 2, 0x8A3C, 0x7A4, 0xAAA)
    assert bytes(frames[0]).hex(" ") == "00 00 00 00 06 00 00 00 02 8a 3c 7a 4a aa 00 00"
    values, words, other, marked = decode((0, bytes.fromhex("028a3c7a4aaa")))
    assert values[:, 1] == pytest.approx([1 - 10 / 65535, -2.0, 6 + 18 / 4095], abs=1e-12)
    assert not values[:, [0, 2]].any()
    assert words[codec.W_SEEN].tolist() == [0, 1, 0]
    assert (other, marked) == ([0], 0)


def test_long_answer_has_temperature_and_error() -> None:
    # As above, then 31 °C = 1Fh, error 3.
    values, words, _, _ = decode((0, bytes.fromhex("018a3c7a4aaa1f03")))
    assert values[codec.F_V, 0] == pytest.approx(-2.0)
    assert words[codec.W_TEMPERATURE, 0] == 31
    assert words[codec.W_ERROR, 0] == 3
    assert states.state_of(words[codec.W_STATUS, 0]) == states.FAULT


def test_the_answer_to_a_special_frame_is_the_new_state() -> None:
    words = np.zeros((codec.W_ROWS, 3), dtype=np.int64)
    words[codec.W_STATUS] = READY
    words[codec.W_AFTER] = ENABLED
    words[codec.W_ASKED] = [codec.ENTER, codec.TORQUE, codec.ENTER]
    answers = [(0, bytes([node, 0x80, 0, 0x80, 0, 0])) for node in (1, 2)]
    decode(*answers, words=words)
    assert words[codec.W_STATUS].tolist() == [ENABLED, READY, READY]


def test_the_first_answer_after_leave_may_be_a_late_one() -> None:
    words = np.zeros((codec.W_ROWS, 3), dtype=np.int64)
    words[codec.W_STATUS] = ENABLED
    words[codec.W_AFTER] = READY
    words[codec.W_ASKED] = codec.LEAVE
    answer = (0, bytes([1, 0x80, 0, 0x80, 0, 0]))
    decode(answer, words=words)
    assert words[codec.W_STATUS, 0] == ENABLED
    decode(answer, words=words)
    assert words[codec.W_STATUS].tolist() == [READY, ENABLED, ENABLED]
    words[codec.W_STATUS, 0], words[codec.W_ASKED] = ENABLED, codec.TORQUE
    decode(answer, words=words)  # counts anew from here on
    words[codec.W_ASKED] = codec.LEAVE
    decode(answer, words=words)
    assert words[codec.W_STATUS, 0] == ENABLED


@pytest.mark.parametrize(
    ("can_id", "data", "mark"),
    [
        (0, bytes([1, 0, 0, 0, 0]), 3),  # a byte short
        (0, b"", 3),
        (0, bytes([3, 0, 0, 0, 0, 0]), 1),  # nobody has node id 3
        (1, bytes([1, 0, 0, 0, 0, 0]), 1),  # a command to node 1
        (0x8000_0000, bytes([1, 0, 0, 0, 0, 0]), 1),  # 29-bit identifier 0
        (0x4000_0000, bytes([1, 0, 0, 0, 0, 0]), 1),  # remote request
        (0x2000_0004, bytes(8), 1),  # error frame
    ],
)
def test_foreign_and_short_frames_change_nothing(can_id: int, data: bytes, mark: int) -> None:
    values, words, other, marked = decode((can_id, data))
    assert not values.any()
    assert not words.any()
    assert (other, marked) == ([mark], 1)


def test_another_host_id() -> None:
    answer = bytes.fromhex("028a3c7a4aaa")
    assert decode((0x7F, answer), host=0x7F)[2] == [0]
    assert decode((0, answer), host=0x7F)[2] == [1]


def test_sign_offset_and_torque_constant_are_applied() -> None:
    (sheet,) = scales(1, sign=-1, zero_offset_rad=0.25, torque_constant=0.9)
    wire = np.repeat(wire_table([sheet]), 3, axis=1)
    values, _, _, _ = decode((0, bytes.fromhex("018a3c7a4aaa")), wire=wire)
    expected = [-(1 - 10 / 65535) - 0.25, 2.0, -0.9 * (6 + 18 / 4095)]
    assert values[:, 0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("bits", [12, 16])
def test_ends_and_beyond(bits: int) -> None:
    most = (1 << bits) - 1
    for x, code in ((-18.0, 0), (-1e9, 0), (math.nan, 0), (18.0, most), (1e9, most)):
        assert codec.float_to_uint(x, -18.0, 18.0, bits) == code
    assert codec.uint_to_float(0, -18.0, 18.0, bits) == -18.0
    assert codec.uint_to_float(most, -18.0, 18.0, bits) == 18.0


@given(st.floats(-45.0, 45.0))
def test_a_code_is_less_than_a_step_below_its_number(x: float) -> None:
    step = 90.0 / 4095
    below = codec.uint_to_float(codec.float_to_uint(x, -45.0, 45.0, 12), -45.0, 45.0, 12)
    assert -1e-12 < x - below < step * (1 + 1e-9)


@given(*[st.integers(0, 4095)] * 3, st.integers(0, 65535), st.integers(0, 4095))
def test_any_command_there_and_back(v: int, kp: int, kd: int, p: int, t: int) -> None:
    frames, back = frame_buffer(1), np.zeros(5, dtype=np.int64)
    codec.encode_command(frames, 0, 9, p, v, kp, kd, t)
    codec.decode_command(frames, 0, back)
    assert back.tolist() == [p, v, kp, kd, t]


@given(st.floats(-12.4, 12.4), st.floats(-44.9, 44.9), st.floats(-17.9, 17.9))
def test_any_answer_there_and_back_within_half_a_step(q: float, v: float, t: float) -> None:
    frames = frame_buffer(1)
    codec.encode_answer(
        frames, 0, 0, 6, 5,
        codec.float_to_uint(q, -12.5, 12.5, 16),
        codec.float_to_uint(v, -45.0, 45.0, 12),
        codec.float_to_uint(t, -18.0, 18.0, 12),
    )  # fmt: skip
    values, _, _, _ = decode(unpack(frames[0]))
    half = 0.5 * np.array([25.0 / 65535, 90.0 / 4095, 36.0 / 4095])
    assert np.all(np.abs(values[:, 2] - [q, v, t]) <= half * (1 + 1e-9))


@given(st.lists(st.integers(-32768, 32767), min_size=1, max_size=20), st.integers(0, 65535))
def test_a_position_that_wraps_is_carried_on(steps: list[int], start: int) -> None:
    wire = np.repeat(wire_table(scales(1, wraps=True)), 3, axis=1)
    words = np.zeros((codec.W_ROWS, 3), dtype=np.int64)
    words[codec.W_CODE] = true = start
    for step in steps:
        true += step
        raw = true % 65536
        values, _, _, _ = decode(
            (0, bytes([1, raw >> 8, raw & 255, 0, 0, 0])), words=words, wire=wire
        )
        assert words[codec.W_CODE, 0] == true
        assert values[codec.F_Q, 0] == pytest.approx((true + 0.5) * 25 / 65535 - 12.5)


def test_a_position_that_does_not_wrap_is_taken_as_it_comes() -> None:
    _, words, _, _ = decode((0, b"\1\xff\xf0\0\0\0"), (0, b"\1\0\x10\0\0\0"))
    assert words[codec.W_CODE, 0] == 0x10
