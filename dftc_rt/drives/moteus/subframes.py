"""Subframes of the moteus protocol, of which the data of a frame consist: pure kernels.

Numbers are sent with the least significant byte first.

    write   00h + 4 format + count, first register, values
    read    10h + 4 format + count, first register
    reply   20h + 4 format + count, first register, values
    error   30h of a write, 31h of a read: register, number
    NOP     50h, to fill a frame up to a length that CAN FD has

A count of more than 3 is sent behind the first byte, whose two count bits are then 0. Counts,
registers and error numbers are varuints: 7 bits a byte, bit 7 says that more follow.

Source: [moteus], "CAN Protocol".
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.moteus import registers as reg

U8 = NDArray[np.uint8]

WRITE: Final = 0x00
READ: Final = 0x10
REPLY: Final = 0x20
WRITE_ERROR: Final = 0x30
READ_ERROR: Final = 0x31
NOP: Final = 0x50
LONGEST: Final = 64


@njit(cache=True)
def fd_length(length: int) -> int:
    """Return the least length that CAN FD has for so many bytes."""
    if length <= 8:
        return length
    if length <= 24:
        return (length + 3) // 4 * 4
    if length <= 32:
        return 32
    return 48 if length <= 48 else LONGEST


@njit(cache=True)
def size_of(kind: int) -> int:
    """Return the bytes of one value of a format."""
    return 4 if kind == reg.FLOAT else 1 << kind


@njit(cache=True)
def read_varuint(data: U8, at: int, end: int) -> tuple[int, int]:
    """Return (number, where it ends); the end is -1 when there is none."""
    value = 0
    for k in range(5):
        if at + k >= end:
            return 0, -1
        byte = int(np.int64(data[at + k]))
        value |= (byte & 0x7F) << (7 * k)
        if byte & 0x80 == 0:
            return value, at + k + 1
    return 0, -1


@njit(cache=True)
def write_varuint(data: U8, at: int, value: int) -> int:
    """Write a number; return where it ends."""
    while value > 0x7F:
        data[at] = value & 0x7F | 0x80
        value >>= 7
        at += 1
    data[at] = value
    return int(at + 1)


@njit(cache=True)
def read_head(data: U8, at: int, end: int) -> tuple[int, int, int, int, int]:
    """Read what a subframe begins with.

    Args:
        data: Data of a frame, (64,).
        at: Where it begins; ``at < end``.
        end: Bytes of the frame.

    Returns:
        Kind (WRITE, READ, REPLY, NOP, WRITE_ERROR, READ_ERROR; -1: none that is known, or cut
        off), format, count, first register, where the values begin. Of an error, count is its
        number.
    """
    byte = int(np.int64(data[at]))
    at += 1
    if byte == NOP:
        return NOP, 0, 0, 0, at
    if byte in (WRITE_ERROR, READ_ERROR):
        register, at = read_varuint(data, at, end)
        if at < 0:
            return -1, 0, 0, 0, end
        number, at = read_varuint(data, at, end)
        if at < 0:
            return -1, 0, 0, 0, end
        return byte, 0, number, register, at
    kind = byte & 0xF0
    if kind > REPLY:
        return -1, 0, 0, 0, end
    form = byte >> 2 & 3
    count = byte & 3
    if count == 0:
        count, at = read_varuint(data, at, end)
        if at < 0:
            return -1, 0, 0, 0, end
        if count == 0:  # of nothing, and no register follows
            return kind, form, 0, 0, at
    register, at = read_varuint(data, at, end)
    if at < 0 or (kind != READ and at + count * size_of(form) > end):
        return -1, 0, 0, 0, end
    return kind, form, count, register, at


@njit(cache=True)
def write_head(data: U8, at: int, kind: int, form: int, count: int, register: int) -> int:
    """Write what a subframe of registers begins with; return where its values begin."""
    if count <= 3:
        data[at] = kind | form << 2 | count
        at += 1
    else:
        data[at] = kind | form << 2
        at = write_varuint(data, at + 1, count)
    return int(write_varuint(data, at, register))


@njit(cache=True)
def read_value(data: U8, at: int, form: int, unit: int) -> float:
    """Return a value, in its unit; NaN for the integer that stands for it.

    A register without a unit of measure has no such integer.
    """
    bits = 0
    size = size_of(form)
    for k in range(size):
        bits |= int(np.int64(data[at + k])) << (8 * k)
    if form == reg.FLOAT:
        return float(np.int32(bits).view(np.float32))
    least = -(1 << (8 * size - 1))
    if bits >= -least:
        bits += 2 * least
    if bits == least and unit != reg.WHOLE:
        return math.nan
    return float(bits * reg.STEPS[unit, form])


@njit(cache=True)
def write_value(data: U8, at: int, form: int, unit: int, value: float) -> int:
    """Write a value; return where it ends.

    An integer is cut off towards zero and limited to ± its largest; what is not finite becomes
    the most negative one.
    """
    size = size_of(form)
    if form == reg.FLOAT:
        bits = int(np.int64(np.float32(value).view(np.int32)))
    else:
        most = (1 << (8 * size - 1)) - 1
        if not math.isfinite(value):
            bits = -most - 1
        else:
            counts = value / reg.STEPS[unit, form] * (1.0 + 1e-12)  # 0.29 is 29 hundredths
            bits = int(min(max(counts, float(-most)), float(most)))
    for k in range(size):
        data[at + k] = bits >> (8 * k) & 0xFF
    return int(at + size)
