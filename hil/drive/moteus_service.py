"""What the emulated moteus drives do with a frame: kernels over all drives, no Python objects.

What a frame writes and reads is in :mod:`hil.drive.moteus_registers`. It is answered once the
rig has moved on to it, so that the answer is of that moment. In position mode the torque is

    torque + kp kp_scale (position − actual) + kd kd_scale (velocity − actual)

which a real drive evaluates in its control loop and this one when a command comes; a position
of NaN is the actual one. There is no integral part, no limit and no trajectory.

Source: [moteus], "Register Reference".
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus import subframes as sub
from dftc_rt.drives.moteus.scale import TORQUE_STEP
from hil.drive import moteus_registers as own_registers
from hil.drive import slots
from hil.drive.moteus_registers import DEFAULT_TIMEOUT, MODE, NODE

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

SYNCED: Final = 1  # receive: a torque command, or a question alone, was taken
SWITCHED: Final = 2  # receive: a stop was taken

KP: Final = 4.0  # Nm/rev, as delivered
KD: Final = 0.05  # Nm s/rev
_ID: Final = 0x1FFF_FFFF
_NOT_DATA: Final = 0x6000_0000


@njit(cache=True)
def _off(d: int, objects: I64) -> None:
    """No torque, and the brake closes."""
    objects[d, slots.ENABLED] = 0
    objects[d, slots.COMMAND] = 0


@njit(cache=True)
def _stop(d: int, objects: I64, own: I64) -> None:
    """Take the mode "stopped", unless the cause of a fault lasts."""
    _off(d, objects)
    if objects[d, slots.FAULT_PRESENT] == 0:
        objects[d, slots.ERROR_CODE] = 0
        own[d, MODE] = reg.STOPPED


@njit(cache=True)
def _or(value: float, default: float) -> float:
    return default if math.isnan(value) else value


@njit(cache=True)
def _follow(d: int, objects: I64, own: I64, command: F64, turns: F64, now: int) -> None:
    """Take a command of position mode: the torque that follows from it, and its watchdog."""
    if own[d, MODE] in (reg.FAULTED, reg.TIMED_OUT):
        return
    own[d, MODE] = reg.IN_POSITION
    row = objects[d]
    row[slots.ENABLED] = 1
    row[slots.COMMANDS] += 1
    row[slots.RPDO_TIME] = now
    timeout = command[reg.COMMAND_TIMEOUT - reg.COMMAND]
    if math.isnan(timeout):
        row[slots.WATCHDOG] = 0
    elif timeout > 0.0:
        row[slots.WATCHDOG] = np.int64(np.rint(timeout * 1e6))
    else:
        row[slots.WATCHDOG] = own[d, DEFAULT_TIMEOUT]
    actual, speed = row[slots.POSITION] * turns[d], row[slots.VELOCITY] * turns[d]
    position = _or(command[reg.COMMAND_POSITION - reg.COMMAND], actual)
    velocity = _or(command[reg.COMMAND_VELOCITY - reg.COMMAND], 0.0)
    kp = _or(command[reg.COMMAND_KP_SCALE - reg.COMMAND], 1.0)
    kd = min(_or(command[reg.COMMAND_KD_SCALE - reg.COMMAND], 1.0), kp)
    torque = _or(command[reg.COMMAND_TORQUE - reg.COMMAND], 0.0)
    torque += KP * kp * (position - actual) + KD * kd * (velocity - speed)
    counts = torque / TORQUE_STEP
    most = float(row[slots.MAX_TORQUE])
    limit = command[reg.COMMAND_MAX_TORQUE - reg.COMMAND]
    if not math.isnan(limit):
        most = min(most, limit / TORQUE_STEP)
    row[slots.COMMAND] = np.int64(np.rint(min(max(counts, -most), most)))


@njit(cache=True)
def receive(
    frames: U8,
    start: int,
    count: int,
    lookup: I32,
    objects: I64,
    own: I64,
    registers: F64,
    turns: F64,
    asked: U8,
    askers: I64,
    now: int,
) -> int:
    """Take frames of one bus.

    Args:
        frames: Batch, (capacity, 72).
        start: First row to take.
        count: Rows filled.
        lookup: Node id -> drive (-1: none), (128,).
        objects: All drives, (n, N_OBJECTS).
        own: All drives, (n, OWN).
        registers: Commands of all drives, (n, COMMANDS).
        turns: Revolutions of one encoder count, (n,).
        asked: Frames that are to be answered, written behind those that wait, (capacity, 72).
        askers: Element 0: how many wait there; 1 and on: which drive is asked.
        now: Rig time, µs.

    Returns:
        Sum of those that hold of SYNCED and SWITCHED.
    """
    heads = frames.view(np.int64)
    what = 0
    for r in range(start, count):
        head = heads[r, 0]
        number = head & _ID
        if head & _NOT_DATA != 0 or number > 0xFFFF or number & 0x80 != 0:
            continue
        d = lookup[number & 0x7F]
        if d < 0 or objects[d, slots.OFF_BUS]:
            continue
        end = min((head >> 32) & 0xFF, sub.LONGEST)
        mode, reads = own_registers.write(frames[r, 8:], end, registers[d])
        if mode == reg.STOPPED:
            what |= SWITCHED
            _stop(d, objects, own)
        elif mode == reg.IN_POSITION:
            what |= SYNCED
            _follow(d, objects, own, registers[d], turns, now)
        elif reads and mode == own_registers.NO_COMMAND:
            what |= SYNCED
        if number & codec.REPLY_BIT and askers[0] < asked.shape[0]:
            asked[askers[0]] = frames[r]
            askers[0] += 1
            askers[askers[0]] = d
    return what


@njit(cache=True)
def proceed(objects: I64, own: I64, now: int) -> None:
    """Let the watchdogs run: without a command for too long, a drive gives up.

    Args:
        objects: All drives, (n, N_OBJECTS).
        own: All drives, (n, OWN).
        now: Rig time, µs.
    """
    for d in range(objects.shape[0]):
        row = objects[d]
        limit = row[slots.WATCHDOG]
        if row[slots.ENABLED] and limit > 0 and now - row[slots.RPDO_TIME] > limit:
            _off(d, objects)
            own[d, MODE] = reg.TIMED_OUT


@njit(cache=True)
def answer(
    out: U8,
    senders: I32,
    objects: I64,
    own: I64,
    registers: F64,
    turns: F64,
    asked: U8,
    askers: I64,
) -> int:
    """Write the answers to what the drives of one bus were asked; return how many rows.

    Args:
        out: Batch to fill from row 0, (capacity, 72).
        senders: Drive of each row, filled, (>= capacity,).
        objects: All drives, (n, N_OBJECTS).
        own: All drives, (n, OWN).
        registers: Commands of all drives, (n, COMMANDS).
        turns: Revolutions of one encoder count, (n,).
        asked: Frames that are to be answered, (capacity, 72).
        askers: Element 0: how many of them; 1 and on: which drive is asked.
    """
    questions, answers = asked.view(np.int64), out.view(np.int64)
    rows = 0
    for r in range(min(askers[0], out.shape[0])):
        d = askers[1 + r]
        if objects[d, slots.OFF_BUS]:
            continue
        head = questions[r, 0]
        end = min((head >> 32) & 0xFF, sub.LONGEST)
        out[rows, 8:] = sub.NOP
        length = own_registers.respond(
            asked[r, 8:], end, out[rows, 8:], d, objects, own, registers, turns
        )
        source = (head >> 8) & 0x7F
        identifier = own[d, NODE] << 8 | source
        answers[rows, 0] = codec.head_of(identifier, sub.fd_length(length))
        senders[rows] = d
        rows += 1
    askers[0] = 0
    return rows
