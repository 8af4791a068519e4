"""What the emulated MIT drives do with a frame: kernels over all drives, no Python objects.

A drive answers every frame that is addressed to it, once the rig has moved on to it, so that
the answer is of that moment. In motor mode the torque is

    t_ff + kp (p_des − p) + kd (v_des − v)

which a real drive evaluates in its current loop and this one when a command comes.

Source: [katz2018]; ``main.cpp``, ``CAN_com.cpp`` of its firmware.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.mit import codec
from dftc_rt.drives.mit.scale import KD_MAX, KP_MAX, P_MAX, T_CODES, T_MAX, V_MAX, WRAPS
from hil.drive import slots

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

# Columns of the (n, OWN) int64 matrix: what only these drives have.
NODE: Final = 0  # node id
HOST: Final = 1  # identifier of the answers
LENGTH: Final = 2  # bytes of an answer
ORIGIN: Final = 3  # encoder counts at the drive's zero
PENDING: Final = 4  # frames that are to be answered
OWN: Final = 5

SYNCED: Final = 1  # receive: a command was taken
SWITCHED: Final = 2  # receive: a special frame was taken

_TEMPERATURE: Final = 30  # °C, of a motor that never gets warm
_MAX_FRAME: Final = 0x7FF


@njit(cache=True)
def _position(objects: I64, own: I64, radians: F64, d: int) -> float:
    """Return a drive's position, rad, from its own zero."""
    return float((objects[d, slots.POSITION] - own[d, ORIGIN]) * radians[d])


@njit(cache=True)
def write_answer(out: U8, row: int, d: int, objects: I64, own: I64, wire: F64, radians: F64) -> int:
    """Write a drive's answer as it stands; return the row after it.

    Args:
        out: Batch, (capacity, 16).
        row: Row to fill.
        d: Drive.
        objects: All drives, (n, N_OBJECTS).
        own: All drives, (n, OWN).
        wire: From ``scale.wire_table``.
        radians: One encoder count, (n,), rad.
    """
    p_max, v_max = wire[P_MAX, d], wire[V_MAX, d]
    p = _position(objects, own, radians, d)
    if wire[WRAPS, d] != 0.0:
        codes = (1 << codec.P_BITS) - 1
        position = np.int64(np.floor((p + p_max) * codes / (2.0 * p_max))) & codes
    else:
        position = np.int64(codec.float_to_uint(p, -p_max, p_max, codec.P_BITS))
    v = objects[d, slots.VELOCITY] * radians[d]
    t = objects[d, slots.TORQUE_ACTUAL] * wire[T_MAX, d] / T_CODES
    velocity = codec.float_to_uint(v, -v_max, v_max, codec.BITS)
    torque = codec.float_to_uint(t, -wire[T_MAX, d], wire[T_MAX, d], codec.BITS)
    length = own[d, LENGTH]
    after: int = codec.encode_answer(
        out, row, own[d, HOST], length, own[d, NODE], position, velocity, torque
    )
    if length == codec.LONG_ANSWER:
        out[row, 14] = _TEMPERATURE
        out[row, 15] = objects[d, slots.ERROR_CODE]
    return after


@njit(cache=True)
def _leave(row: I64) -> None:
    """Leave motor mode: no torque, and the brake closes."""
    row[slots.ENABLED] = 0
    row[slots.COMMAND] = 0


@njit(cache=True)
def _follow(codes: I64, d: int, objects: I64, own: I64, wire: F64, radians: F64) -> None:
    """Take a command in motor mode: the torque that follows from its five codes."""
    p_des = codec.uint_to_float(codes[0], -wire[P_MAX, d], wire[P_MAX, d], codec.P_BITS)
    v_des = codec.uint_to_float(codes[1], -wire[V_MAX, d], wire[V_MAX, d], codec.BITS)
    kp = codec.uint_to_float(codes[2], 0.0, wire[KP_MAX, d], codec.BITS)
    kd = codec.uint_to_float(codes[3], 0.0, wire[KD_MAX, d], codec.BITS)
    p = _position(objects, own, radians, d)
    v = objects[d, slots.VELOCITY] * radians[d]
    feedback = (kp * (p_des - p) + kd * (v_des - v)) * T_CODES / wire[T_MAX, d]
    limit = objects[d, slots.MAX_TORQUE]
    wanted = 2.0 * codes[4] - T_CODES + feedback
    objects[d, slots.COMMAND] = np.int64(np.rint(min(max(wanted, -limit), limit)))


@njit(cache=True)
def receive(
    frames: U8,
    start: int,
    count: int,
    lookup: I32,
    objects: I64,
    own: I64,
    wire: F64,
    radians: F64,
    now: int,
) -> int:
    """Take frames of one bus.

    Args:
        frames: Batch, (capacity, 16).
        start: First row to take.
        count: Rows filled.
        lookup: Identifier -> drive (-1: none), (2048,).
        objects: All drives, (n, N_OBJECTS).
        own: All drives, (n, OWN).
        wire: From ``scale.wire_table``.
        radians: One encoder count, (n,), rad.
        now: Rig time, µs.

    Returns:
        Sum of those that hold of SYNCED and SWITCHED.
    """
    heads = frames.view(np.int64)
    codes = np.empty(5, dtype=np.int64)
    what = 0
    for r in range(start, count):
        head = heads[r, 0]
        can_id = head & 0xFFFFFFFF
        if can_id > _MAX_FRAME or (head >> 32) & 0xFF != codec.COMMAND_BYTES:
            continue
        d = lookup[can_id]
        if d < 0 or objects[d, slots.OFF_BUS]:
            continue
        row = objects[d]
        row[slots.RPDO_TIME] = now
        own[d, PENDING] += 1
        asked = codec.special(frames, r)
        if asked == codec.TORQUE:
            what |= SYNCED
            row[slots.COMMANDS] += 1
            if row[slots.ENABLED]:
                codec.decode_command(frames, r, codes)
                _follow(codes, d, objects, own, wire, radians)
            continue
        what |= SWITCHED
        if asked == codec.ZERO_HERE:
            own[d, ORIGIN] = row[slots.POSITION]
        elif asked == codec.LEAVE:
            _leave(row)
        elif row[slots.ERROR_CODE] == 0:
            row[slots.ENABLED] = 1
    return what


@njit(cache=True)
def proceed(objects: I64, now: int) -> None:
    """Let the watchdogs run: without a frame for too long, a drive leaves motor mode.

    Args:
        objects: All drives, (n, N_OBJECTS).
        now: Rig time, µs.
    """
    for d in range(objects.shape[0]):
        row = objects[d]
        limit = row[slots.WATCHDOG]
        if row[slots.ENABLED] and limit > 0 and now - row[slots.RPDO_TIME] > limit:
            _leave(row)


@njit(cache=True)
def answer(
    out: U8,
    senders: I32,
    members: I64,
    objects: I64,
    own: I64,
    wire: F64,
    radians: F64,
) -> int:
    """Write what the drives of one bus have to say; return how many rows.

    Args:
        out: Batch to fill from row 0, (capacity, 16).
        senders: Drive of each row, filled, (>= capacity,).
        members: Drives on this bus, (m,).
        objects: All drives, (n, N_OBJECTS).
        own: All drives, (n, OWN).
        wire: From ``scale.wire_table``.
        radians: One encoder count, (n,), rad.
    """
    rows = 0
    for k in range(members.shape[0]):
        d = members[k]
        if objects[d, slots.OFF_BUS]:
            own[d, PENDING] = 0
        while own[d, PENDING] > 0 and rows < out.shape[0]:
            own[d, PENDING] -= 1
            senders[rows] = d
            rows = write_answer(out, rows, d, objects, own, wire, radians)
    return int(rows)
