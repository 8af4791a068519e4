"""Registers of the emulated moteus drives: what a frame writes, and the answer to what it reads.

Writing the mode begins a command; what else it consists of follows in the same frame, and what
is left out is as the drive's documentation says. The answer has a reply for each read, and an
error for each register that is not there (1), not to be written (2), or a mode that these
drives do not have (3).

Source: [moteus], "Register Reference"; error numbers: ``moteus_controller.cc`` of its firmware.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus import subframes as sub
from dftc_rt.drives.moteus.scale import TORQUE_STEP
from hil.drive import slots

U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

# Columns of the (n, OWN) int64 matrix: what only these drives have.
NODE: Final = 0  # node id
MODE: Final = 1  # register 0x000
DEFAULT_TIMEOUT: Final = 2  # watchdog of commands that bring none, µs; 0: none
OWN: Final = 3

NO_COMMAND: Final = -1  # what a frame that writes no mode writes
REFUSED: Final = -2  # what one does that writes a mode that these drives do not have

UNKNOWN_REGISTER: Final = 1
NOT_WRITABLE: Final = 2
NO_SUCH_MODE: Final = 3

_VOLTAGE: Final = 24.0  # V
_TEMPERATURE: Final = 30.0  # °C, of a board that never gets warm
_VOLTAGE_REGISTER: Final = 0x00D
_TEMPERATURES: Final = (0x00A, 0x00E)
_ABSOLUTE: Final = 0x006


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
        The mode that it writes, NO_COMMAND or REFUSED; whether it reads.
    """
    mode = NO_COMMAND
    reads = False
    at = 0
    while at < end:
        kind, form, count, register, at = sub.read_head(data, at, end)
        if kind < 0:
            break
        if kind == sub.READ:
            reads = True
        if kind not in (sub.WRITE, sub.REPLY):
            continue
        for k in range(count):
            unit = reg.unit_of(register + k)
            if kind == sub.WRITE and unit != reg.NONE:
                value = sub.read_value(data, at, form, unit)
                if write_error(register + k, value) == 0:
                    if register + k == reg.MODE:
                        mode = int(value)
                        _forget(command)
                    else:
                        command[register + k - reg.COMMAND] = value
                elif register + k == reg.MODE:
                    mode = REFUSED
            at += sub.size_of(form)
    return mode, reads


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
    if at + 1 + _varuint_bytes(register) + _varuint_bytes(number) > sub.LONGEST:
        return -1
    data[at] = kind
    return int(sub.write_varuint(data, sub.write_varuint(data, at + 1, register), number))


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
            at = _error(data, at, sub.READ_ERROR, register + k, UNKNOWN_REGISTER)
            if at < 0:
                return -1
            k += 1
            continue
        run = 1
        while k + run < count and reg.unit_of(register + k + run) != reg.NONE:
            run += 1
        head = 1 + (1 if run > 3 else 0) + _varuint_bytes(register + k)
        if at + head + run * sub.size_of(form) > sub.LONGEST:
            return -1
        at = sub.write_head(data, at, sub.REPLY, form, run, register + k)
        for j in range(run):
            number = register + k + j
            value = value_of(number, d, objects, own, registers, turns)
            at = sub.write_value(data, at, form, reg.unit_of(number), value)
        k += run
    return at


@njit(cache=True)
def respond(
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
        kind, form, count, register, at = sub.read_head(question, at, end)
        if kind < 0:
            break
        if kind == sub.READ:
            more = _reply(data, length, form, count, register, d, objects, own, registers, turns)
            if more < 0:
                break
            length = more
        elif kind in (sub.WRITE, sub.REPLY):
            for k in range(count):
                value = sub.read_value(question, at, form, reg.WHOLE)
                at += sub.size_of(form)
                number = write_error(register + k, value) if kind == sub.WRITE else 0
                if number:
                    more = _error(data, length, sub.WRITE_ERROR, register + k, number)
                    if more < 0:
                        return length
                    length = more
    return length
