"""Frames of the cycle against bytes worked out by hand from CiA 301 and CiA 402-2."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.bus.frame import frame_buffer, pack, unpack
from dftc_rt.drives.cia402 import codec
from dftc_rt.drives.scale import JointScale, ScaleTable

NODES = np.array([1, 2, 5])
MEMBERS = np.arange(3)
# One count is one unit everywhere, so that what is read is what is in the frame.
UNIT = ScaleTable(np.array([[1.0] * 3, [0.0] * 3, [1.0] * 3, [32767.0] * 3]))
LOOKUP = codec.feedback_lookup(MEMBERS, NODES)


def decode(*frames: tuple[int, bytes]):
    values = np.zeros((codec.F_ROWS, 3))
    words = np.zeros((codec.W_ROWS, 3), dtype=np.int64)
    other = np.full(16, 9, dtype=np.uint8)
    batch = frame_buffer(16)
    for row, (can_id, data) in enumerate(frames):
        batch[row] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    marked = codec.decode_feedback(batch, len(frames), LOOKUP, UNIT.values, values, words, other)
    return values, words, other[: len(frames)].tolist(), marked


def test_rpdo1_bytes() -> None:
    # Identifier 200h + node 5 = 205h = 05 02 00 00 little-endian, 4 data bytes.
    # Controlword 000Fh = 0F 00. Target torque −300 ‰ = FED4h = D4 FE. Rest padding.
    frames = frame_buffer(4)
    word = np.array([0, 0, 0x000F])
    torque = np.array([0, 0, -300])
    rows = codec.encode_commands(frames, 1, np.array([2]), NODES, word, torque)
    assert rows == 2
    assert bytes(frames[1]).hex(" ") == "05 02 00 00 04 00 00 00 0f 00 d4 fe 00 00 00 00"
    assert not frames[0].any()


def test_sync_bytes() -> None:
    # Identifier 080h. With a counter: one byte; without (1019h = 0): no data at all.
    frames = frame_buffer(2)
    assert codec.encode_sync(frames, 0, 240) == 1
    assert bytes(frames[0]).hex(" ") == "80 00 00 00 01 00 00 00 f0 00 00 00 00 00 00 00"
    codec.encode_sync(frames, 1, 0)
    assert bytes(frames[1]).hex(" ") == "80 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00"


def test_nmt_and_heartbeat_bytes() -> None:
    # NMT: identifier 0, command specifier 80h (enter pre-operational), node id 7.
    # Heartbeat: 700h + 127 = 77Fh, one byte, state 5 (operational).
    frames = frame_buffer(2)
    codec.encode_nmt(frames, 0, 0x80, 7)
    assert bytes(frames[0]).hex(" ") == "00 00 00 00 02 00 00 00 80 07 00 00 00 00 00 00"
    codec.encode_heartbeat(frames, 1, 127, 5)
    assert bytes(frames[1]).hex(" ") == "7f 07 00 00 01 00 00 00 05 00 00 00 00 00 00 00"


def test_tpdo1_bytes() -> None:
    # 180h + 2. Position −2 counts = FFFFFFFEh = FE FF FF FF;
    # velocity 66 000 counts/s = 000101D0h = D0 01 01 00.
    values, words, other, marked = decode((0x182, bytes.fromhex("feffffff d0010100")))
    assert values[codec.F_Q].tolist() == [0, -2, 0]
    assert values[codec.F_V].tolist() == [0, 66_000, 0]
    assert words[codec.W_SEEN].tolist() == [0, 1, 0]
    assert (other, marked) == ([0], 0)


def test_tpdo2_bytes() -> None:
    # 280h + 1. Statusword 1237h = 37 12: bits 0, 1, 2, 5 (operation enabled), 4 (voltage),
    # 9 (remote), 12 (follows the command). Mode display 10 = 0A.
    _, words, _, _ = decode((0x281, bytes.fromhex("37120a")))
    assert words[codec.W_STATUS, 0] == 0x1237
    assert words[codec.W_MODE, 0] == 10
    assert words[codec.W_SEEN].tolist() == [2, 0, 0]


def test_tpdo3_bytes() -> None:
    # 380h + 5. Torque actual −1 ‰ = FFFFh.
    values, words, _, _ = decode((0x385, bytes.fromhex("ffff")))
    assert values[codec.F_TORQUE].tolist() == [0, 0, -1]
    assert words[codec.W_SEEN].tolist() == [0, 0, 4]


def test_emergency_bytes() -> None:
    # 080h + 5. Error code 8130h (heartbeat lost) = 30 81, register 11h (generic,
    # communication), five bytes of the manufacturer's.
    data = bytes.fromhex("3081 11 0102030405")
    _, words, other, marked = decode((0x085, data))
    assert words[codec.W_EMCY].tolist() == [0, 0, 0x8130]
    assert words[codec.W_REGISTER].tolist() == [0, 0, 0x11]
    assert words[codec.W_EMCYS].tolist() == [0, 0, 1]
    assert (other, marked) == ([2], 1)
    assert codec.decode_emcy(data) == (0x8130, 0x11, b"\1\2\3\4\5")


def test_heartbeat_is_counted() -> None:
    _, words, _, _ = decode((0x702, b"\x05"), (0x702, b"\x7f"))
    assert words[codec.W_NMT].tolist() == [0, 127, 0]
    assert words[codec.W_HEARTBEATS].tolist() == [0, 2, 0]


@pytest.mark.parametrize(
    ("can_id", "data", "mark"),
    [
        (0x181, bytes(7), 3),  # too short for position and velocity
        (0x281, bytes(2), 3),
        (0x381, bytes(1), 3),
        (0x081, bytes(2), 3),
        (0x701, b"", 3),
        (0x183, bytes(8), 1),  # nobody has node id 3
        (0x581, bytes(8), 1),  # SDO
        (0x080, b"", 1),  # SYNC is not an emergency of node 0
        (0x8000_0181, bytes(8), 1),  # 29-bit identifier 181h
        (0x4000_0181, bytes(8), 1),  # remote request
        (0x2000_0004, bytes(8), 1),  # error frame
    ],
)
def test_foreign_and_short_frames_change_nothing(can_id: int, data: bytes, mark: int) -> None:
    values, words, other, marked = decode((can_id, data))
    assert not values.any()
    assert not words.any()
    assert (other, marked) == ([mark], 1)


i32 = st.integers(-(2**31), 2**31 - 1)


@given(i32, i32)
def test_any_feedback_there_and_back(position: int, velocity: int) -> None:
    values, _, _, _ = decode((0x181, struct.pack("<ii", position, velocity)))
    assert values[codec.F_Q, 0] == position
    assert values[codec.F_V, 0] == velocity


@given(st.integers(0, 0xFFFF), st.integers(-32768, 32767))
def test_any_command_there_and_back(word: int, torque: int) -> None:
    frames = frame_buffer(1)
    codec.encode_commands(
        frames, 0, np.array([0]), NODES, np.array([word, 0, 0]), np.array([torque, 0, 0])
    )
    assert unpack(frames[0]) == (0x201, struct.pack("<Hh", word, torque))


def test_position_is_carried_over_the_wrap_of_int32() -> None:
    # 7FFFFFFFh and then 80000000h: one count further, not 2³² back.
    values, words, _, _ = decode(
        (0x181, bytes.fromhex("ffffff7f 00000000")), (0x181, bytes.fromhex("00000080 00000000"))
    )
    assert words[codec.W_COUNTS, 0] == 2**31
    assert values[codec.F_Q, 0] == 2.0**31


def test_scale_sign_and_offset_are_applied() -> None:
    sheet = JointScale("a", 1000, 50.0, 100.0, sign=-1, zero_offset_rad=0.25)
    values = np.zeros((codec.F_ROWS, 1))
    words = np.zeros((codec.W_ROWS, 1), dtype=np.int64)
    batch = frame_buffer(2)
    batch[0] = np.frombuffer(pack(0x181, struct.pack("<ii", 250, 500)), dtype=np.uint8)
    batch[1] = np.frombuffer(pack(0x381, struct.pack("<h", 100)), dtype=np.uint8)
    lookup = codec.feedback_lookup(np.array([0]), np.array([1]))
    table = ScaleTable.of([sheet]).values
    codec.decode_feedback(batch, 2, lookup, table, values, words, np.zeros(2, dtype=np.uint8))
    # 250 of 1000 counts backwards: −π/2, less the offset; 100 ‰ of 50 Nm backwards: −5 Nm.
    assert values[:, 0] == pytest.approx([-np.pi / 2 - 0.25, -np.pi, -5.0])
