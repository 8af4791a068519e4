"""Frames of the moteus protocol against bytes worked out by hand from its documentation."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.bus.frame import BRS, EFF_FLAG, ERR_FLAG, FD_FRAME_SIZE, FDF, frame_buffer, pack_fd
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus import subframes as sub
from dftc_rt.drives.moteus.scale import wire_table
from tests.unit.drives.moteus.moteus_bus import scales

NODES = np.array([1, 2, 5])
WIRE = wire_table(scales(3))
LOOKUP = np.full(128, -1, dtype=np.int32)
LOOKUP[NODES] = np.arange(3)
READY = int(states.STATE_BITS[states.SWITCHED_ON])
ENABLED = int(states.STATE_BITS[states.OPERATION_ENABLED])
TURN = 2.0 * math.pi


_DATA = np.zeros(64, dtype=np.uint8)  # compile now: hypothesis minds an example that takes long
sub.read_value(_DATA, sub.write_value(_DATA, 0, reg.INT8, reg.WHOLE, 0.0), 0, 0)
sub.read_varuint(_DATA, sub.write_varuint(_DATA, 0, 0), 64)
sub.read_head(_DATA, sub.write_head(_DATA, 0, sub.READ, 0, 1, 0), 64)
codec.decode_answer(_DATA, sub.fd_length(64), np.zeros(5))


def padded(data: str) -> bytes:
    """Fill up with NOPs to a length of CAN FD that is long enough here."""
    raw = bytes.fromhex(data)
    return raw.ljust(next(n for n in (8, 12, 16, 20, 24, 32, 64) if n >= len(raw)), b"\x50")


def decode(*frames: tuple[int, bytes], words=None, wire=WIRE, host=0):
    values = np.zeros((codec.F_ROWS, 3))
    if words is None:
        words = np.zeros((codec.W_ROWS, 3), dtype=np.int64)
    other = np.full(16, 9, dtype=np.uint8)
    batch = frame_buffer(16, FD_FRAME_SIZE)
    for row, (can_id, data) in enumerate(frames):
        batch[row] = np.frombuffer(pack_fd(can_id, data), dtype=np.uint8)
    marked = codec.decode_answers(
        batch, len(frames), host, LOOKUP, wire, values, words, np.zeros(5), other
    )
    return values, words, other[: len(frames)].tolist(), marked


# --- commands --------------------------------------------------------------------------


def test_torque_command_bytes() -> None:
    # 01 00 0a        write 1 int8 from 000h: mode 10, position
    # 02 20 80 00     write 2 int8 from 020h: position NaN (-128), velocity 0
    # 05 22 70 fe     write 1 int16 at 022h: -4 Nm = -400 = FE70h
    # 02 23 00 00     write 2 int8 from 023h: kp scale 0, kd scale 0
    # 01 27 05        write 1 int8 at 027h: 50 ms
    # 11 00           read 1 int8 at 000h: mode
    # 1d 01           read 1 float at 001h: position
    # 16 02           read 2 int16 from 002h: velocity, torque
    # Node 5 of host 3, reply asked for: 8000h + 0300h + 05h, more than 7FFh: 29 bits.
    frames = frame_buffer(2, FD_FRAME_SIZE)
    assert codec.encode_torque(frames, 1, 5, 3, -400, 5) == 2
    head, data = bytes(frames[1, :8]), bytes(frames[1, 8:])
    assert head.hex(" ") == "05 83 00 80 18 05 00 00"  # 24 bytes; FDF, BRS
    assert data[:24].hex(" ") == (
        "01 00 0a 02 20 80 00 05 22 70 fe 02 23 00 00 01 27 05 11 00 1d 01 16 02"
    )
    assert not any(data[24:])
    assert not frames[0].any()


def test_stop_and_query_bytes() -> None:
    # Mode 0; then mode, position, velocity and torque as above, and 00Fh as int8; one NOP.
    frames = frame_buffer(2, FD_FRAME_SIZE)
    assert codec.encode_stop(frames, 0, 1, 0) == 1
    assert bytes(frames[0, :20]).hex() == "01800080" + "0c050000" + "01000011001d011602110f50"
    assert codec.encode_query(frames, 1, 1, 0) == 2
    assert bytes(frames[1, :16]).hex() == "01800080" + "08050000" + "11001d011602110f"
    assert not frames[1, 16:].any()


def test_a_cycle_has_one_frame_a_joint() -> None:
    frames = frame_buffer(4, FD_FRAME_SIZE)
    asked = np.array([codec.STOP, codec.TORQUE, codec.QUERY])
    torque = np.array([7, 300, 9])
    rows = codec.encode_cycle(frames, 1, np.array([1, 2]), NODES, 0, asked, torque, 0)
    assert rows == 3
    assert (frames[1, 0], frames[1, 4]) == (2, 24)
    assert bytes(frames[1, 17:19]) == bytes.fromhex("2c01")  # 300
    assert (frames[2, 0], frames[2, 4]) == (5, 8)
    assert not frames[[0, 3]].any()


# --- answers ---------------------------------------------------------------------------


def test_answer_bytes() -> None:
    # 21 00 0a                   mode 10
    # 2d 01 00 00 a0 be          position: float -0.3125 = BEA00000h (-1.25 · 2^-2)
    # 26 02 90 01 70 fe          velocity 400 · 0.00025 = 0.1 rev/s; torque -400 · 0.01 = -4 Nm
    values, words, other, marked = decode((0x0200, padded("21000a 2d010000a0be 26029001 70fe")))
    assert values[:, 1] == pytest.approx([-0.3125 * TURN, 0.1 * TURN, -4.0])
    assert not values[:, [0, 2]].any()
    assert words[codec.W_SEEN].tolist() == [0, 1, 0]
    assert words[codec.W_MODE, 1] == 10
    assert words[codec.W_STATUS, 1] == ENABLED
    assert (other, marked) == ([0], 0)


def test_the_answer_in_the_documentation() -> None:
    # Its example: mode 10, position 80 · 0.0001 rev = 2.88°, velocity 256 · 0.00025 rev/s =
    # 23.04°/s, torque -144 · 0.01 Nm; 12 V, 20 °C, no fault.
    data = bytes.fromhex("2404000a005000000170ff230d181400")
    values, words, other, _ = decode((0x100, data))
    assert other == [0]
    assert np.degrees(values[:2, 0]) == pytest.approx([2.88, 23.04])
    assert values[codec.F_TORQUE, 0] == pytest.approx(-1.44)
    assert words[[codec.W_MODE, codec.W_FAULT], 0].tolist() == [10, 0]


@pytest.mark.parametrize(
    ("position", "velocity", "expected"),
    [
        ("2101e7", "210205", (-0.25, 0.5)),  # int8: -25 · 0.01, 5 · 0.1
        ("25013cf6", "2502d007", (-0.25, 0.5)),  # int16: -2500 · 1e-4, 2000 · 2.5e-4
        ("2901589effff", "290250c30000", (-0.25, 0.5)),  # int32: -25000 · 1e-5, 50000 · 1e-5
        ("2d01000080be", "2d020000003f", (-0.25, 0.5)),
    ],
)
def test_any_format_is_understood(
    position: str, velocity: str, expected: tuple[float, float]
) -> None:
    values, _, other, _ = decode((0x100, padded(position + velocity)))
    assert other == [0]
    assert values[:2, 0] / TURN == pytest.approx(expected)


def test_joint_units() -> None:
    sheet = scales(1, sign=-1, zero_offset_rad=0.5, torque_constant=0.8)
    wire = np.repeat(wire_table(sheet), 3, axis=1)
    values, *_ = decode((0x100, padded("2d010000803e 2602a00f6400")), wire=wire)
    # 0.25 rev, 4000 · 0.00025 = 1 rev/s, 100 · 0.01 = 1 Nm
    assert values[:, 0] == pytest.approx([-0.25 * TURN - 0.5, -TURN, -0.8])


@pytest.mark.parametrize(
    ("can_id", "data", "why"),
    [
        (0x0300, "2f01" + "00" * 12, 1),  # no joint of ours
        (0x0105, "2f01" + "00" * 12, 1),  # to another host
        (EFF_FLAG | 0x8001, "11001d011602110f", 1),  # another host's question to a drive
        (ERR_FLAG | 0x0100, "2f01" + "00" * 12, 1),
        (0x0100, "", 3),
        (0x0100, "21000a", 3),
        (0x0100, "31020150", 3),  # an error in place of the position
        (0x0100, "2d010000c07f 2502d007", 3),  # position NaN
        (0x0100, "25010080 2502d007", 3),  # and as an integer
        (0x0100, "2f01000000000000", 3),  # cut off
        (0x0100, "7f" + "2f01" + "00" * 12, 3),  # no subframe that is known
        (0x0100, "2480808080802f01" + "00" * 12, 3),  # a number without end
        (0x0100, "0d0100000000 0d0200000000", 3),  # writes are no replies
    ],
)
def test_other_frames(can_id: int, data: str, why: int) -> None:
    values, words, other, marked = decode((can_id, padded(data) if data else b""))
    assert (other, marked) == ([why], 1)
    assert not values.any()
    assert not words.any()


@pytest.mark.parametrize(
    ("mode", "state"),
    [
        (0, states.SWITCHED_ON),
        (1, states.FAULT),
        (2, states.SWITCH_ON_DISABLED),  # as before
        (4, states.SWITCH_ON_DISABLED),
        (5, states.FAULT),
        (10, states.OPERATION_ENABLED),
        (11, states.FAULT),
        (12, states.FAULT),
    ],
)
def test_modes_as_states(mode: int, state: int) -> None:
    words = np.zeros((codec.W_ROWS, 3), dtype=np.int64)
    words[codec.W_STATUS] = states.STATE_BITS[states.SWITCH_ON_DISABLED]
    words[codec.W_AFTER] = READY
    decode((0x100, padded(f"2100{mode:02x} 2f01" + "00" * 12)), words=words)
    assert states.state_of(words[codec.W_STATUS, 0]) == state


def test_fault_code() -> None:
    _, words, _, _ = decode((0x500, padded("210001 2f01" + "00" * 12 + "210f21")))
    assert words[codec.W_FAULT].tolist() == [0, 0, 33]


# --- values and numbers ----------------------------------------------------------------

UNITS = st.sampled_from(range(reg.STEPS.shape[0]))
FORMATS = st.sampled_from([reg.INT8, reg.INT16, reg.INT32, reg.FLOAT])


@given(st.integers(0, 2**32 - 1), st.integers(0, 50))
def test_varuints_come_back(value: int, at: int) -> None:
    data = np.zeros(64, dtype=np.uint8)
    end = sub.write_varuint(data, at, value)
    assert sub.read_varuint(data, at, 64) == (value, end)
    # 7 bits a byte, the last without bit 7
    assert end - at == max(1, -(-value.bit_length() // 7))
    assert sub.read_varuint(data, at, end - 1)[1] == -1


@given(st.integers(-(2**31), 2**31 - 1), UNITS, st.integers(0, 2))
def test_integers_are_counts_of_their_steps(number: int, unit: int, form: int) -> None:
    code = "bhi"[form]
    size = struct.calcsize(code)
    number = (number + (1 << 8 * size - 1)) % (1 << 8 * size) - (1 << 8 * size - 1)
    data = np.zeros(64, dtype=np.uint8)
    data[3 : 3 + size] = np.frombuffer(struct.pack("<" + code, number), dtype=np.uint8)
    value = sub.read_value(data, 3, form, unit)
    if number == -(1 << 8 * size - 1) and unit != reg.WHOLE:
        assert math.isnan(value)
    else:
        assert value == pytest.approx(number * reg.STEPS[unit, form])
    if unit == reg.WHOLE and number == -(1 << 8 * size - 1):
        return
    back = np.zeros(64, dtype=np.uint8)
    assert sub.write_value(back, 3, form, unit, value) == 3 + size
    assert np.array_equal(back, data)


@given(st.floats(width=32), UNITS)
def test_floats_come_back(value: float, unit: int) -> None:
    data = np.zeros(64, dtype=np.uint8)
    assert sub.write_value(data, 5, reg.FLOAT, unit, value) == 9
    assert struct.unpack("<f", data[5:9].tobytes())[0] == pytest.approx(value, nan_ok=True)
    assert sub.read_value(data, 5, reg.FLOAT, unit) == pytest.approx(value, nan_ok=True)


@given(st.floats(-1e300, 1e300) | st.sampled_from([math.nan, math.inf, -math.inf]), UNITS,
       st.integers(0, 2))  # fmt: skip
def test_written_integers_are_cut_off_and_limited(value: float, unit: int, form: int) -> None:
    data = np.zeros(64, dtype=np.uint8)
    size = sub.size_of(form)
    sub.write_value(data, 0, form, unit, value)
    number = int.from_bytes(data[:size].tobytes(), "little", signed=True)
    most = (1 << 8 * size - 1) - 1
    if not math.isfinite(value):
        assert number == -most - 1
        return
    counts = value / reg.STEPS[unit, form]
    assert abs(number) <= most
    if abs(counts) < most:
        assert abs(number) <= abs(counts) * (1 + 1e-9)
        assert abs(counts - number) < 1.0
    else:
        assert number == math.copysign(most, counts)


@given(st.integers(0, 64))
def test_lengths_of_can_fd(length: int) -> None:
    lengths = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
    assert sub.fd_length(length) == next(n for n in lengths if n >= length)


@given(st.integers(0, 3), FORMATS, st.integers(1, 14), st.integers(0, 0x1FF))
def test_heads_of_subframes_come_back(kind: int, form: int, count: int, register: int) -> None:
    kind = (sub.WRITE, sub.READ, sub.REPLY, sub.REPLY)[kind]
    data = np.zeros(64, dtype=np.uint8)
    values = sub.write_head(data, 2, kind, form, count, register)
    assert sub.read_head(data, 2, 64) == (kind, form, count, register, values)


@given(st.binary(max_size=64))
def test_nothing_that_comes_is_read_beyond_its_end(raw: bytes) -> None:
    data = np.zeros(64, dtype=np.uint8)
    data[: len(raw)] = np.frombuffer(raw, dtype=np.uint8)
    at = 0
    while at < len(raw):
        kind, form, count, _, values = sub.read_head(data, at, len(raw))
        assert at < values <= len(raw)
        if kind < 0:
            break
        at = values
        if kind in (sub.WRITE, sub.REPLY):
            at += count * sub.size_of(form)
        assert at <= len(raw)
    codec.decode_answer(data, len(raw), np.zeros(5))


def test_flags_are_those_of_the_bus() -> None:
    assert codec.head_of(0x7FF, 8) == 0x7FF | 8 << 32 | (FDF | BRS) << 40
    assert codec.head_of(0x800, 8) == 0x800 | EFF_FLAG | 8 << 32 | (FDF | BRS) << 40
