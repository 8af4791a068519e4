"""Bytes of the cyclic frames, controller's side: pure kernels, no I/O, no allocation.

Frames are rows of a ``(capacity, 16)`` uint8 matrix (:mod:`dftc_rt.bus.frame`), read and
written here as two little-endian 64-bit words: identifier, length and padding; data.

    RPDO1  200h + id   controlword u16, target torque i16        type 1
    TPDO1  180h + id   position i32, velocity i32                type 1
    TPDO2  280h + id   statusword u16, mode display i8           type 255, inhibit time
    TPDO3  380h + id   torque actual i16                         type 10, staggered

Source: CiA 301 (PDO, SYNC, EMCY, heartbeat), CiA 402-2 (objects).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.cia402 import states
from dftc_rt.drives.cia402.objects import BOOT_UP
from dftc_rt.drives.scale import RAD_PER_COUNT, TORQUE_PER_COUNT, ZERO_OFFSET, unwrap

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

# Kinds of frame a drive sends, low three bits of a lookup entry.
KIND_FEEDBACK: Final = 0  # TPDO1
KIND_STATUS: Final = 1  # TPDO2
KIND_TORQUE: Final = 2  # TPDO3
KIND_EMCY: Final = 3
KIND_HEARTBEAT: Final = 4

# Rows of the (F_ROWS, n) float matrix that decode_feedback fills.
F_Q: Final = 0  # rad
F_V: Final = 1  # rad/s
F_TORQUE: Final = 2  # torque actual, Nm
F_ROWS: Final = 3

# Rows of the (W_ROWS, n) int64 matrix that decode_feedback fills.
W_SEEN: Final = 0  # bit k is set when a frame of kind k came; the caller clears it
W_COUNTS: Final = 1  # position, unwrapped counts
W_STATUS: Final = 2  # statusword
W_MODE: Final = 3  # mode display
W_EMCY: Final = 4  # last emergency error code
W_REGISTER: Final = 5  # error register that came with it
W_EMCYS: Final = 6  # emergencies so far
W_NMT: Final = 7  # NMT state in the last heartbeat
W_HEARTBEATS: Final = 8  # heartbeats so far
W_STARTED: Final = 9  # 1 after the first position, from which unwrapping goes on
W_ROWS: Final = 10

_BASES: Final = (0x180, 0x280, 0x380, 0x080, 0x700)
_BOOT_UP: Final = BOOT_UP
_OFF: Final = int(states.STATE_BITS[states.SWITCH_ON_DISABLED])
_SHORTEST: Final = np.array([8, 3, 2, 3, 1], dtype=np.int64)


def feedback_lookup(members: I64, node_ids: I64) -> I32:
    """Return identifier -> joint·8 + kind (−1: not ours) for one bus, (2048,).

    Args:
        members: Joints on this bus, (m,).
        node_ids: Node ids of all joints, (n,).
    """
    lookup = np.full(2048, -1, dtype=np.int32)
    for joint in members:
        for kind, base in enumerate(_BASES):
            lookup[base + node_ids[joint]] = joint * 8 + kind
    return lookup


@njit(cache=True)
def encode_commands(
    frames: U8, row: int, members: I64, node_ids: I64, controlword: I64, counts: I64
) -> int:
    """Write RPDO1 of the joints on one bus; return the row after the last one.

    Args:
        frames: Batch, (capacity, 16).
        row: First row to fill.
        members: Joints on this bus, (m,).
        node_ids: Node ids of all joints, (n,).
        controlword: 6040h of all joints, (n,).
        counts: 6071h of all joints, (n,), per mille of rated.
    """
    words = frames.view(np.int64)
    for k in range(members.shape[0]):
        i = members[k]
        words[row, 0] = (0x200 + node_ids[i]) | (4 << 32)
        words[row, 1] = (controlword[i] & 0xFFFF) | ((counts[i] & 0xFFFF) << 16)
        row += 1
    return row


@njit(cache=True)
def encode_sync(frames: U8, row: int, counter: int) -> int:
    """Write SYNC; return the row after it.

    Args:
        frames: Batch, (capacity, 16).
        row: Row to fill.
        counter: 1 to 240, or 0 for a SYNC without data (object 1019h is 0).
    """
    words = frames.view(np.int64)
    words[row, 0] = 0x80 | ((1 if counter > 0 else 0) << 32)
    words[row, 1] = counter
    return row + 1


@njit(cache=True)
def encode_heartbeat(frames: U8, row: int, node_id: int, state: int) -> int:
    """Write the heartbeat of a node; return the row after it."""
    words = frames.view(np.int64)
    words[row, 0] = (0x700 + node_id) | (1 << 32)
    words[row, 1] = state
    return row + 1


@njit(cache=True)
def encode_nmt(frames: U8, row: int, command: int, node_id: int) -> int:
    """Write an NMT command, node id 0 meaning all; return the row after it."""
    words = frames.view(np.int64)
    words[row, 0] = 2 << 32
    words[row, 1] = command | (node_id << 8)
    return row + 1


@njit(cache=True)
def _signed(word: int, shift: int, bits: int) -> int:
    """Return a signed field of a 64-bit data word."""
    value = (word >> shift) & ((1 << bits) - 1)
    if value >> (bits - 1):
        value -= 1 << bits
    return value


@njit(cache=True)
def decode_feedback(
    frames: U8, count: int, lookup: I32, scale: F64, values: F64, words: I64, other: U8
) -> int:
    """Take in the frames of one bus, in the order they came.

    A frame that is too short for what it should carry is left alone, as is any frame of
    an unknown identifier; both are marked in ``other``.

    Args:
        frames: Batch, (capacity, 16).
        count: Rows filled.
        lookup: From :func:`feedback_lookup`, (2048,).
        scale: ``ScaleTable.values``, (4, n).
        values: Filled: (F_ROWS, n), joint units.
        words: Filled: (W_ROWS, n).
        other: Filled for ``count`` rows: 0 taken, 1 not ours, 2 emergency, 3 too short.

    Returns:
        Number of rows marked in ``other``.
    """
    raw = frames.view(np.int64)
    marked = 0
    for r in range(count):
        head = raw[r, 0]
        can_id = head & 0xFFFFFFFF
        what = lookup[can_id] if can_id < 2048 else -1
        if what < 0:
            other[r] = 1
            marked += 1
            continue
        kind = what & 7
        i = what >> 3
        if (head >> 32) & 0xFF < _SHORTEST[kind]:
            other[r] = 3
            marked += 1
            continue
        other[r] = 0
        data = raw[r, 1]
        words[W_SEEN, i] |= 1 << kind
        if kind == KIND_FEEDBACK:
            counts = _signed(data, 0, 32)
            if words[W_STARTED, i]:
                counts = unwrap(words[W_COUNTS, i], counts)
            words[W_STARTED, i] = 1
            words[W_COUNTS, i] = counts
            values[F_Q, i] = scale[RAD_PER_COUNT, i] * counts - scale[ZERO_OFFSET, i]
            values[F_V, i] = scale[RAD_PER_COUNT, i] * _signed(data, 32, 32)
        elif kind == KIND_STATUS:
            words[W_STATUS, i] = data & 0xFFFF
            words[W_MODE, i] = _signed(data, 16, 8)
        elif kind == KIND_TORQUE:
            values[F_TORQUE, i] = scale[TORQUE_PER_COUNT, i] * _signed(data, 0, 16)
        elif kind == KIND_EMCY:
            words[W_EMCY, i] = data & 0xFFFF
            words[W_REGISTER, i] = (data >> 16) & 0xFF
            words[W_EMCYS, i] += 1
            other[r] = 2
            marked += 1
        else:
            words[W_NMT, i] = data & 0x7F
            if words[W_NMT, i] == _BOOT_UP:  # a drive that has just powered on is off
                words[W_STATUS, i] = _OFF
            words[W_HEARTBEATS, i] += 1
    return marked


def decode_emcy(data: bytes) -> tuple[int, int, bytes]:
    """Return (error code, error register, manufacturer's bytes) of an emergency.

    Source: CiA 301, "Emergency object": code u16, register u8, five bytes.
    """
    return int.from_bytes(data[:2], "little"), data[2], bytes(data[3:8])
