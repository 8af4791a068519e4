"""Bytes of the MIT protocol, both ways: pure kernels, no I/O, no allocation.

Frames are rows of a ``(capacity, 16)`` uint8 matrix (:mod:`dftc_rt.bus.frame`). All fields
are unsigned and packed with the most significant bit first.

    command  id = node   position 16, velocity 12, kp 12, kd 12, torque 12 bits
    special  id = node   FF FF FF FF FF FF FF, then FC enter, FD leave motor mode, FE zero
    answer   id = host   node 8, position 16, velocity 12, torque 12 bits,
                         and from some drives temperature 8, error 8

A drive cuts off where it makes a code of a number (``float_to_uint``), so that a code
stands for what lies between it and the next one; answers are decoded to the middle of that.
What a drive is told it takes as it stands (``uint_to_float``).

Source: [katz2018]; ``CAN_com.cpp`` and ``math_ops.cpp`` of its firmware.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.cia402 import states
from dftc_rt.drives.mit.scale import P_MAX, SIGN, T_MAX, TORQUE_CONSTANT, V_MAX, WRAPS, ZERO

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

ENTER: Final = 0xFC  # enter motor mode
LEAVE: Final = 0xFD  # leave it: no torque
ZERO_HERE: Final = 0xFE  # the present position becomes the drive's zero

P_BITS: Final = 16
BITS: Final = 12  # velocity, gains, torque
P_ZERO: Final = 0x7FFF  # float_to_uint of 0; half a step below it
V_ZERO: Final = 0x7FF
T_ZERO: Final = 0x7FF

COMMAND_BYTES: Final = 8
SHORT_ANSWER: Final = 6
LONG_ANSWER: Final = 8

# What a drive was sent last, besides a torque (0): the special frame's last byte.
TORQUE: Final = 0

# Rows of the (F_ROWS, n) float matrix that decode_answers fills.
F_Q: Final = 0  # rad
F_V: Final = 1  # rad/s
F_TORQUE: Final = 2  # by the drive's own account, Nm
F_ROWS: Final = 3

# Rows of the (W_ROWS, n) int64 matrix of the controller's side.
W_SEEN: Final = 0  # 1 when an answer came; the caller clears it
W_CODE: Final = 1  # position code, unwrapped where the drive's wraps
W_STATUS: Final = 2  # statusword
W_ASKED: Final = 3  # what the drive was sent last: TORQUE, ENTER or LEAVE; set by the caller
W_AFTER: Final = 4  # statusword once it has answered ENTER or LEAVE; set by the caller
W_ERROR: Final = 5  # error code of the last long answer
W_TEMPERATURE: Final = 6  # temperature of the last long answer, as sent
W_LEFT: Final = 7  # answers since LEAVE was first sent
W_ROWS: Final = 8

_FAULT: Final = int(states.STATE_BITS[states.FAULT])


@njit(cache=True)
def float_to_uint(x: float, low: float, high: float, bits: int) -> int:
    """Return the code of a number, which is cut off, and limited to the range.

    Args:
        x: The number.
        low: What code 0 stands for.
        high: What the largest code stands for.
        bits: Length of the code.
    """
    codes = (1 << bits) - 1
    if not x > low:  # a number that is none, too
        return 0
    if x >= high:
        return codes
    return int((x - low) * codes / (high - low))


@njit(cache=True)
def uint_to_float(code: int, low: float, high: float, bits: int) -> float:
    """Return the number that a code stands for; as :func:`float_to_uint`."""
    return code * (high - low) / ((1 << bits) - 1) + low


@njit(cache=True)
def encode_command(
    frames: U8, row: int, node_id: int, p: int, v: int, kp: int, kd: int, t: int
) -> int:
    """Write a command from its codes; return the row after it.

    Args:
        frames: Batch, (capacity, 16).
        row: Row to fill.
        node_id: The drive.
        p: Position, 16 bits.
        v: Velocity, 12 bits.
        kp: Position gain, 12 bits.
        kd: Velocity gain, 12 bits.
        t: Torque, 12 bits.
    """
    frames.view(np.int64)[row, 0] = node_id | (COMMAND_BYTES << 32)
    data = frames[row, 8:16]
    data[0] = p >> 8
    data[1] = p & 0xFF
    data[2] = v >> 4
    data[3] = (v & 0xF) << 4 | kp >> 8
    data[4] = kp & 0xFF
    data[5] = kd >> 4
    data[6] = (kd & 0xF) << 4 | t >> 8
    data[7] = t & 0xFF
    return row + 1


@njit(cache=True)
def encode_special(frames: U8, row: int, node_id: int, what: int) -> int:
    """Write ENTER, LEAVE or ZERO_HERE; return the row after it."""
    words = frames.view(np.int64)
    words[row, 0] = node_id | (COMMAND_BYTES << 32)
    words[row, 1] = -1
    frames[row, 15] = what
    return row + 1


@njit(cache=True)
def special(frames: U8, row: int) -> int:
    """Return the last byte of a special frame; 0 for any other frame."""
    for k in range(8, 15):
        if frames[row, k] != 0xFF:
            return 0
    what = int(frames[row, 15])
    return what if ENTER <= what <= ZERO_HERE else 0


@njit(cache=True)
def decode_command(frames: U8, row: int, codes: I64) -> None:
    """Read the codes of a command: position, velocity, kp, kd, torque.

    Args:
        frames: Batch, (capacity, 16).
        row: Row to read.
        codes: Filled, (5,).
    """
    data = frames[row, 8:16]
    codes[0] = np.int64(data[0]) << 8 | data[1]
    codes[1] = np.int64(data[2]) << 4 | data[3] >> 4
    codes[2] = np.int64(data[3] & 0xF) << 8 | data[4]
    codes[3] = np.int64(data[5]) << 4 | data[6] >> 4
    codes[4] = np.int64(data[6] & 0xF) << 8 | data[7]


@njit(cache=True)
def encode_answer(
    frames: U8, row: int, host_id: int, length: int, node_id: int, p: int, v: int, t: int
) -> int:
    """Write an answer from its codes; return the row after it.

    Args:
        frames: Batch, (capacity, 16).
        row: Row to fill; temperature and error of a long answer are the caller's, bytes 6, 7.
        host_id: Identifier.
        length: 6 or 8.
        node_id: The drive that answers.
        p: Position, 16 bits.
        v: Velocity, 12 bits.
        t: Torque, 12 bits.
    """
    words = frames.view(np.int64)
    words[row, 0] = host_id | (length << 32)
    words[row, 1] = 0
    data = frames[row, 8:16]
    data[0] = node_id
    data[1] = p >> 8
    data[2] = p & 0xFF
    data[3] = v >> 4
    data[4] = (v & 0xF) << 4 | t >> 8
    data[5] = t & 0xFF
    return row + 1


@njit(cache=True)
def encode_cycle(frames: U8, row: int, members: I64, node_ids: I64, asked: I64, torque: I64) -> int:
    """Write what each drive of one bus is sent at the tick; return the row after the last.

    Args:
        frames: Batch, (capacity, 16).
        row: First row to fill.
        members: Joints on this bus, (m,).
        node_ids: Node ids of all joints, (n,).
        asked: TORQUE, ENTER or LEAVE of all joints, (n,).
        torque: Torque codes of all joints, (n,).
    """
    for k in range(members.shape[0]):
        i = members[k]
        if asked[i] == TORQUE:
            row = encode_command(frames, row, node_ids[i], P_ZERO, V_ZERO, 0, 0, torque[i])
        else:
            row = encode_special(frames, row, node_ids[i], asked[i])
    return row


@njit(cache=True)
def position_of(code: int, wire: F64, i: int) -> float:
    """Return a joint's position, rad (m), in the middle of what a code stands for."""
    step = 2.0 * wire[P_MAX, i] / ((1 << P_BITS) - 1)
    return float(wire[SIGN, i] * ((code + 0.5) * step - wire[P_MAX, i]) - wire[ZERO, i])


@njit(cache=True)
def _middle(code: int, most: float) -> float:
    """Return the middle of what a 12-bit code of a range ±most stands for."""
    return (code + 0.5) * 2.0 * most / ((1 << BITS) - 1) - most


@njit(cache=True)
def decode_answers(
    frames: U8, count: int, host_id: int, lookup: I32, wire: F64, values: F64, words: I64, other: U8
) -> int:
    """Take in the frames of one bus, in the order they came.

    Args:
        frames: Batch, (capacity, 16).
        count: Rows filled.
        host_id: Identifier of the answers.
        lookup: Node id -> joint (-1: none on this bus), (256,).
        wire: From ``scale.wire_table``.
        values: Filled: (F_ROWS, n), joint units.
        words: Filled: (W_ROWS, n).
        other: Filled for ``count`` rows: 0 taken, 1 not ours, 3 too short.

    Returns:
        Number of rows marked in ``other``.
    """
    heads = frames.view(np.int64)
    marked = 0
    for r in range(count):
        head = heads[r, 0]
        length = (head >> 32) & 0xFF
        data = frames[r, 8:16]
        if head & 0xFFFFFFFF != host_id or (length >= 1 and lookup[data[0]] < 0):
            other[r] = 1
            marked += 1
            continue
        if length < SHORT_ANSWER:
            other[r] = 3
            marked += 1
            continue
        other[r] = 0
        i = lookup[data[0]]
        code = np.int64(data[1]) << 8 | data[2]
        if wire[WRAPS, i] != 0.0:
            delta = (code - words[W_CODE, i]) & 0xFFFF
            if delta >= 0x8000:
                delta -= 0x10000
            code = words[W_CODE, i] + delta
        sign = wire[SIGN, i]
        v = np.int64(data[3]) << 4 | data[4] >> 4
        t = np.int64(data[4] & 0xF) << 8 | data[5]
        words[W_SEEN, i] = 1
        words[W_CODE, i] = code
        values[F_Q, i] = position_of(code, wire, i)
        values[F_V, i] = sign * _middle(v, wire[V_MAX, i])
        values[F_TORQUE, i] = sign * wire[TORQUE_CONSTANT, i] * _middle(t, wire[T_MAX, i])
        # The first answer after LEAVE may be a late one to the torque before it.
        words[W_LEFT, i] = words[W_LEFT, i] + 1 if words[W_ASKED, i] == LEAVE else 0
        if words[W_ASKED, i] == ENTER or words[W_LEFT, i] > 1:
            words[W_STATUS, i] = words[W_AFTER, i]
        if length >= LONG_ANSWER:
            words[W_TEMPERATURE, i] = data[6]
            words[W_ERROR, i] = data[7]
            if data[7] != 0:
                words[W_STATUS, i] = _FAULT
    return marked
