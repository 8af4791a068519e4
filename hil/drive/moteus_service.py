"""What the emulated moteus drives do with a frame: kernels over all drives, no Python objects.

A frame may write and read any registers. Writing the mode begins a command; what else it
consists of follows in the same frame, and what is left out is as the drive's documentation
says. The answer has a reply for each read, and an error for each register that is not there
(1), not to be written (2), or a mode that these drives do not have (3). In position mode the
torque is

    torque + kp kp_scale (position − actual) + kd kd_scale (velocity − actual)

which a real drive evaluates in its control loop and this one when a command comes; a position
of NaN is the actual one. There is no integral part, no limit and no trajectory.

Source: [moteus], "Register Reference"; error numbers: ``moteus_controller.cc`` of its firmware.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus.scale import TORQUE_STEP
from hil.drive import slots

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

# Columns of the (n, OWN) int64 matrix: what only these drives have.
NODE: Final = 0  # node id
MODE: Final = 1  # register 0x000
DEFAULT_TIMEOUT: Final = 2  # watchdog of commands that bring none, µs; 0: none
PENDING: Final = 3  # frames that are to be answered
OWN: Final = 4

SYNCED: Final = 1  # receive: a torque command, or a question alone, was taken
SWITCHED: Final = 2  # receive: a stop was taken
REPEATED: Final = 4  # receive: one was, for a drive that has not answered the last frame yet

KP: Final = 4.0  # Nm/rev, as delivered
KD: Final = 0.05  # Nm s/rev
UNKNOWN_REGISTER: Final = 1
NOT_WRITABLE: Final = 2
NO_SUCH_MODE: Final = 3

_VOLTAGE: Final = 24.0  # V
_TEMPERATURE: Final = 30.0  # °C, of a board that never gets warm
_VOLTAGE_REGISTER: Final = 0x00D
_TEMPERATURES: Final = (0x00A, 0x00E)
_ABSOLUTE: Final = 0x006
_NO_COMMAND: Final = -1
_REFUSED: Final = -2
_ID: Final = 0x1FFF_FFFF
_NOT_DATA: Final = 0x6000_0000


@njit(cache=True)
def write_error(register: int, mode: float) -> int:
    """Return the error number of writing a register; 0 for none.

    Args:
        register: Register.
        mode: The value, of register 0x000.
    """
    if reg.unit_of(register) == reg.NONE:
        return UNKNOWN_REGISTER
    if register == reg.MODE:
        return 0 if mode in (reg.STOPPED, reg.IN_POSITION) else NO_SUCH_MODE
    return 0 if register >= reg.COMMAND else NOT_WRITABLE


@njit(cache=True)
def value_of(register: int, d: int, objects: I64, own: I64, registers: F64, turns: F64) -> float:
    """Return what a register holds, in its unit; the register is known."""
    if register >= reg.COMMAND:
        return float(registers[d, register - reg.COMMAND])
    if register == reg.MODE:
        return float(own[d, MODE])
    if register in (reg.POSITION, _ABSOLUTE):
        return float(objects[d, slots.POSITION] * turns[d])
    if register == reg.VELOCITY:
        return float(objects[d, slots.VELOCITY] * turns[d])
    if register == reg.TORQUE:
        return float(objects[d, slots.TORQUE_ACTUAL] * TORQUE_STEP)
    if register == reg.FAULT:
        return float(objects[d, slots.ERROR_CODE])
    if register == _VOLTAGE_REGISTER:
        return _VOLTAGE
    return _TEMPERATURE if register in _TEMPERATURES else 0.0


@njit(cache=True)
def _forget(command: F64) -> None:
    """Make all of a command what it is when it is left out."""
    command[:] = math.nan
    command[reg.COMMAND_POSITION - reg.COMMAND] = 0.0
    command[reg.COMMAND_VELOCITY - reg.COMMAND] = 0.0
    command[reg.COMMAND_TORQUE - reg.COMMAND] = 0.0
    command[reg.COMMAND_KP_SCALE - reg.COMMAND] = 1.0
    command[reg.COMMAND_KD_SCALE - reg.COMMAND] = 1.0
    command[reg.COMMAND_TIMEOUT - reg.COMMAND] = 0.0


@njit(cache=True)
def write(data: U8, end: int, command: F64) -> tuple[int, bool]:
    """Take what a frame writes.

    Args:
        data: Data of the frame, (64,).
        end: Bytes of it.
        command: Registers of the drive's command, filled, (COMMANDS,).

    Returns:
        The mode that it writes, -1 for none, -2 for one that is refused; whether it reads.
    """
    mode = _NO_COMMAND
    reads = False
    at = 0
    while at < end:
        kind, form, count, register, at = codec.read_head(data, at, end)
        if kind < 0:
            break
        if kind == codec.READ:
            reads = True
        if kind not in (codec.WRITE, codec.REPLY):
            continue
        for k in range(count):
            unit = reg.unit_of(register + k)
            if kind == codec.WRITE and unit != reg.NONE:
                value = codec.read_value(data, at, form, unit)
                if write_error(register + k, value) == 0:
                    if register + k == reg.MODE:
                        mode = int(value)
                        _forget(command)
                    else:
                        command[register + k - reg.COMMAND] = value
                elif register + k == reg.MODE:
                    mode = _REFUSED
            at += codec.size_of(form)
    return mode, reads


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
        Sum of those that hold of SYNCED, SWITCHED and REPEATED.
    """
    heads = frames.view(np.int64)
    what = 0
    for r in range(start, count):
        head = heads[r, 0]
        number = head & _ID
        if head & _NOT_DATA != 0 or number > 0xFFFF or number & 0x80 != 0:
            continue
        d = lookup[number & 0x7F]
        if d < 0:
            continue
        end = min((head >> 32) & 0xFF, codec.LONGEST)
        mode, reads = write(frames[r, 8:], end, registers[d])
        if mode == reg.STOPPED:
            what |= SWITCHED if own[d, PENDING] == 0 else SWITCHED | REPEATED
            _stop(d, objects, own)
        elif mode == reg.IN_POSITION:
            what |= SYNCED
            _follow(d, objects, own, registers[d], turns, now)
        elif reads and mode == _NO_COMMAND:
            what |= SYNCED
        if number & codec.REPLY_BIT and askers[0] < asked.shape[0]:
            asked[askers[0]] = frames[r]
            askers[0] += 1
            askers[askers[0]] = d
            own[d, PENDING] += 1
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
def _varuint_bytes(value: int) -> int:
    """Return the length of a number."""
    length = 1
    while value > 0x7F:
        value >>= 7
        length += 1
    return length


@njit(cache=True)
def _error(data: U8, at: int, kind: int, register: int, number: int) -> int:
    """Write an error; return where it ends, or -1 when there is no room for it."""
    if at + 1 + _varuint_bytes(register) + _varuint_bytes(number) > codec.LONGEST:
        return -1
    data[at] = kind
    return int(codec.write_varuint(data, codec.write_varuint(data, at + 1, register), number))


@njit(cache=True)
def _reply(
    data: U8,
    at: int,
    form: int,
    count: int,
    register: int,
    d: int,
    objects: I64,
    own: I64,
    registers: F64,
    turns: F64,
) -> int:
    """Write the replies to one read; return where they end, or -1 when there is no room."""
    k = 0
    while k < count:
        if reg.unit_of(register + k) == reg.NONE:
            at = _error(data, at, codec.READ_ERROR, register + k, UNKNOWN_REGISTER)
            if at < 0:
                return -1
            k += 1
            continue
        run = 1
        while k + run < count and reg.unit_of(register + k + run) != reg.NONE:
            run += 1
        head = 1 + (1 if run > 3 else 0) + _varuint_bytes(register + k)
        if at + head + run * codec.size_of(form) > codec.LONGEST:
            return -1
        at = codec.write_head(data, at, codec.REPLY, form, run, register + k)
        for j in range(run):
            number = register + k + j
            value = value_of(number, d, objects, own, registers, turns)
            at = codec.write_value(data, at, form, reg.unit_of(number), value)
        k += run
    return at


@njit(cache=True)
def _respond(
    question: U8,
    end: int,
    data: U8,
    d: int,
    objects: I64,
    own: I64,
    registers: F64,
    turns: F64,
) -> int:
    """Write the answer to a frame; return its bytes. What has no room in it is left out."""
    at = 0
    length = 0
    while at < end:
        kind, form, count, register, at = codec.read_head(question, at, end)
        if kind < 0:
            break
        if kind == codec.READ:
            more = _reply(data, length, form, count, register, d, objects, own, registers, turns)
            if more < 0:
                break
            length = more
        elif kind in (codec.WRITE, codec.REPLY):
            for k in range(count):
                value = codec.read_value(question, at, form, reg.WHOLE)
                at += codec.size_of(form)
                number = write_error(register + k, value) if kind == codec.WRITE else 0
                if number:
                    more = _error(data, length, codec.WRITE_ERROR, register + k, number)
                    if more < 0:
                        return length
                    length = more
    return length


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
    rows = min(askers[0], out.shape[0])
    for r in range(askers[0]):
        d = askers[1 + r]
        own[d, PENDING] -= 1
        if r >= rows:
            continue
        head = questions[r, 0]
        end = min((head >> 32) & 0xFF, codec.LONGEST)
        out[r, 8:] = codec.NOP
        length = _respond(asked[r, 8:], end, out[r, 8:], d, objects, own, registers, turns)
        source = (head >> 8) & 0x7F
        identifier = own[d, NODE] << 8 | source
        answers[r, 0] = codec.head_of(identifier, codec.fd_length(length))
        senders[r] = d
    askers[0] = 0
    return int(rows)
