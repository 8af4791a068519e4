"""Bytes of the moteus protocol, both ways: pure kernels, no I/O, no allocation.

Frames are rows of a ``(capacity, 72)`` uint8 matrix (:mod:`dftc_rt.bus.frame`). The identifier
is ``source << 8 | destination``, with REPLY_BIT where an answer is asked for; above 7FFh it has
29 bits. The data are :mod:`~dftc_rt.drives.moteus.subframes`.

Source: [moteus], "CAN Protocol".
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.cia402 import states
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus import subframes as sub

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

REPLY_BIT: Final = 0x8000

# What a drive is sent at a tick; QUERY is 0, what a cycle starts with.
QUERY: Final = 0  # nothing but the question for its state
TORQUE: Final = 1  # position mode with a torque
STOP: Final = 2  # the mode "stopped"

# Rows of the (F_ROWS, n) float matrix that decode_answers fills.
F_Q: Final = 0  # rad (m)
F_V: Final = 1  # rad/s (m/s)
F_TORQUE: Final = 2  # by the drive's own account, Nm (N)
F_ROWS: Final = 3

# Rows of the (W_ROWS, n) int64 matrix of the controller's side.
W_SEEN: Final = 0  # 1 when position and velocity came; the caller clears it
W_STATUS: Final = 1  # statusword
W_ASKED: Final = 2  # what the drive is sent: QUERY, TORQUE or STOP; set by the caller
W_AFTER: Final = 3  # statusword that the mode "stopped" stands for; set by the caller
W_MODE: Final = 4  # mode of the last answer
W_FAULT: Final = 5  # fault code of the last answer that had one
W_ROWS: Final = 6

# Rows of the (WIRE_ROWS, n) float matrix of the scales.
SIGN: Final = 0
ZERO: Final = 1  # what the drive shows, in joint units, at q = 0, rad (m)
TORQUE_CONSTANT: Final = 2  # true over nominal
WIRE_ROWS: Final = 3

_EFF: Final = 0x8000_0000
_NOT_DATA: Final = 0x6000_0000  # remote and error frames
_ID: Final = 0x1FFF_FFFF
_FLAGS: Final = 0x05 << 40  # FDF, BRS
_SHORT_ID: Final = 0x7FF
_TAU: Final = 2.0 * math.pi
_FAULT: Final = int(states.STATE_BITS[states.FAULT])
_ENABLED: Final = int(states.STATE_BITS[states.OPERATION_ENABLED])

# 0x000 = 10 | 0x020 = NaN, 0x021 = 0 | 0x022 = torque, int16 | 0x023 = 0x024 = 0 | 0x027 |
# mode as int8 | position as float | velocity and torque as int16
_TORQUE_DATA: Final = np.array(
    [
        0x01, 0x00, 0x0A, 0x02, 0x20, 0x80, 0x00, 0x05, 0x22, 0x00, 0x00, 0x02, 0x23, 0x00, 0x00,
        0x01, 0x27, 0x00, 0x11, 0x00, 0x1D, 0x01, 0x16, 0x02,
    ],
    dtype=np.uint8,
)  # fmt: skip
_TORQUE_AT: Final = 8 + 9  # bytes of the row
_TIMEOUT_AT: Final = 8 + 17
# 0x000 = 0 | as above, and the fault code as int8
_STOP_DATA: Final = np.array(
    [0x01, 0x00, 0x00, 0x11, 0x00, 0x1D, 0x01, 0x16, 0x02, 0x11, 0x0F, 0x50], dtype=np.uint8
)
_QUERY_DATA: Final = _STOP_DATA[3:11].copy()


@njit(cache=True)
def head_of(identifier: int, length: int) -> int:
    """Return the first eight bytes of an FD frame that switches the bit rate, as a word."""
    extended = _EFF if identifier > _SHORT_ID else 0
    return identifier | extended | (length << 32) | _FLAGS


@njit(cache=True)
def _fill(frames: U8, row: int, identifier: int, data: U8) -> None:
    """Write a frame that asks for an answer."""
    length = data.shape[0]
    frames.view(np.int64)[row, 0] = head_of(identifier, length)
    for k in range(length):
        frames[row, 8 + k] = data[k]


@njit(cache=True)
def encode_torque(
    frames: U8, row: int, node_id: int, host_id: int, torque: int, timeout: int
) -> int:
    """Write a torque command, which asks for the state; return the row after it.

    Args:
        frames: Batch, (capacity, 72).
        row: Row to fill.
        node_id: The drive.
        host_id: Who asks.
        torque: Feed-forward torque, 0.01 Nm, within ±32767.
        timeout: The drive's watchdog, 0.01 s, 0 to 127; 0: as the drive is set.
    """
    _fill(frames, row, REPLY_BIT | host_id << 8 | node_id, _TORQUE_DATA)
    frames[row, _TORQUE_AT] = torque & 0xFF
    frames[row, _TORQUE_AT + 1] = torque >> 8 & 0xFF
    frames[row, _TIMEOUT_AT] = timeout
    return row + 1


@njit(cache=True)
def encode_stop(frames: U8, row: int, node_id: int, host_id: int) -> int:
    """Write the mode "stopped" and ask for state and fault; return the row after it."""
    _fill(frames, row, REPLY_BIT | host_id << 8 | node_id, _STOP_DATA)
    return row + 1


@njit(cache=True)
def encode_query(frames: U8, row: int, node_id: int, host_id: int) -> int:
    """Ask for state and fault, and write nothing; return the row after it."""
    _fill(frames, row, REPLY_BIT | host_id << 8 | node_id, _QUERY_DATA)
    return row + 1


@njit(cache=True)
def encode_cycle(
    frames: U8,
    row: int,
    members: I64,
    node_ids: I64,
    host_id: int,
    asked: I64,
    torque: I64,
    timeout: int,
) -> int:
    """Write what each drive of one bus is sent at the tick; return the row after the last.

    Args:
        frames: Batch, (capacity, 72).
        row: First row to fill.
        members: Joints on this bus, (m,).
        node_ids: Node ids of all joints, (n,).
        host_id: Who asks.
        asked: QUERY, TORQUE or STOP of all joints, (n,).
        torque: Torques of all joints, (n,), 0.01 Nm.
        timeout: As of :func:`encode_torque`.
    """
    for k in range(members.shape[0]):
        i = members[k]
        if asked[i] == TORQUE:
            row = encode_torque(frames, row, node_ids[i], host_id, torque[i], timeout)
        elif asked[i] == STOP:
            row = encode_stop(frames, row, node_ids[i], host_id)
        else:
            row = encode_query(frames, row, node_ids[i], host_id)
    return row


@njit(cache=True)
def status_of(mode: int, before: int, after: int) -> int:
    """Return the statusword that says the same as a mode.

    Args:
        mode: Register 0x000.
        before: Statusword so far.
        after: What "stopped" stands for now.
    """
    if mode == reg.STOPPED:
        return after
    if mode == reg.IN_POSITION:
        return _ENABLED
    if reg.FAULTED < mode <= reg.PREPARING:
        return before
    return _FAULT  # fault, time-out, and modes that nobody here asks for


@njit(cache=True)
def decode_answer(data: U8, end: int, found: F64) -> bool:
    """Read the state from an answer, whatever formats it comes in.

    Args:
        data: Data of the frame, (64,).
        end: Bytes of the frame.
        found: Filled, (5,): mode, position, velocity, torque, fault; NaN for what is not there.

    Returns:
        Whether position and velocity are there.
    """
    found[:] = math.nan
    at = 0
    while at < end:
        kind, form, count, register, at = sub.read_head(data, at, end)
        if kind < 0:
            break
        if kind not in (sub.WRITE, sub.REPLY):
            continue
        for k in range(count):
            unit = reg.unit_of(register + k)
            if kind == sub.REPLY and unit != reg.NONE:
                value = sub.read_value(data, at, form, unit)
                if register + k <= reg.TORQUE:
                    found[register + k] = value
                elif register + k == reg.FAULT:
                    found[4] = value
            at += sub.size_of(form)
    return not (math.isnan(found[1]) or math.isnan(found[2]))


@njit(cache=True)
def decode_answers(
    frames: U8,
    count: int,
    host_id: int,
    lookup: I32,
    wire: F64,
    values: F64,
    words: I64,
    found: F64,
    other: U8,
) -> int:
    """Take in the frames of one bus, in the order they came.

    Args:
        frames: Batch, (capacity, 72).
        count: Rows filled.
        host_id: Whom the answers are for.
        lookup: Node id -> joint (-1: none on this bus), (128,).
        wire: (WIRE_ROWS, n).
        values: Filled: (F_ROWS, n), joint units.
        words: Filled: (W_ROWS, n).
        found: Room to work in, (5,).
        other: Filled for ``count`` rows: 0 taken, 1 not ours, 3 without position or velocity.

    Returns:
        Number of rows marked in ``other``.
    """
    heads = frames.view(np.int64)
    marked = 0
    for r in range(count):
        head = heads[r, 0]
        number = head & _ID
        source = number >> 8
        if head & _NOT_DATA != 0 or number & 0xFF != host_id or source > 0x7F or lookup[source] < 0:
            other[r] = 1
            marked += 1
            continue
        if not decode_answer(frames[r, 8:], min((head >> 32) & 0xFF, sub.LONGEST), found):
            other[r] = 3
            marked += 1
            continue
        other[r] = 0
        i = lookup[source]
        words[W_SEEN, i] = 1
        values[F_Q, i] = wire[SIGN, i] * _TAU * found[1] - wire[ZERO, i]
        values[F_V, i] = wire[SIGN, i] * _TAU * found[2]
        if not math.isnan(found[3]):
            values[F_TORQUE, i] = wire[SIGN, i] * wire[TORQUE_CONSTANT, i] * found[3]
        if not math.isnan(found[4]):
            words[W_FAULT, i] = np.int64(found[4])
        if not math.isnan(found[0]):
            words[W_MODE, i] = np.int64(found[0])
            before, after = words[W_STATUS, i], words[W_AFTER, i]
            words[W_STATUS, i] = status_of(words[W_MODE, i], before, after)
    return marked
