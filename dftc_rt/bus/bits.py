"""How many bits a classical CAN frame takes on the wire.

A data frame of n bytes is SOF, identifier, control, data, CRC-15 (the part that is
stuffed: a bit of the other value after five equal ones), then 13 bits that are not:
CRC delimiter, acknowledge, its delimiter, end of frame (7), intermission (3).
Bits without stuffing: 47 + 8n with an 11-bit identifier, 67 + 8n with 29 bits; at
worst, every fourth bit after the first is a stuff bit.

Source: ISO 11898-1:2015; Bosch CAN 2.0 (1991), parts A and B.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.fields import can_id, data_bytes, length_code
from dftc_rt.bus.frame import Frames

_CRC: Final = 15
_CRC_POLYNOMIAL: Final = 0x4599
_UNSTUFFED: Final = 13
_STUFFED_11: Final = 34  # SOF to CRC without data, 11-bit identifier
_STUFFED_29: Final = 54


def nominal_bits(length: int, extended: bool = False) -> int:
    """Return the bits of a frame without any stuffing, intermission included.

    Args:
        length: Data bytes, 0 … 8.
        extended: 29-bit identifier.
    """
    return (_STUFFED_29 if extended else _STUFFED_11) + 8 * length + _UNSTUFFED


def worst_bits(length: int, extended: bool = False) -> int:
    """Return the bits of a frame when its content causes the most stuffing.

    Args:
        length: Data bytes, 0 … 8.
        extended: 29-bit identifier.
    """
    stuffed = (_STUFFED_29 if extended else _STUFFED_11) + 8 * length
    return stuffed + _UNSTUFFED + (stuffed - 1) // 4


@numba.njit("int64(uint8[:, ::1], int64)", cache=True)
def exact_bits(frames: Frames, row: int) -> int:
    """Return the bits of the frame in ``row``: its own stuffing, intermission included.

    Args:
        frames: Classical batch, uint8, shape ``(capacity, 16)``.
        row: Row to look at.
    """
    identifier: int = can_id(frames, row)
    remote = (identifier >> 30) & 1
    payload: int = data_bytes(frames, row)

    # The header as one number, most significant bit first; SOF is the zero above.
    if identifier >> 31:
        header = ((identifier >> 18) & 0x7FF) << 2 | 3  # SRR and IDE recessive
        header = header << 18 | (identifier & 0x3FFFF)
        header = (header << 1 | remote) << 2  # r1, r0
        header_bits = _STUFFED_29 - _CRC
    else:
        header = (identifier & 0x7FF) << 3 | remote << 2  # IDE and r0 dominant
        header_bits = _STUFFED_11 - _CRC
    header = header << 4 | length_code(frames, row)

    checked = header_bits + 8 * payload
    total = checked + _CRC
    crc = 0
    run = 0
    last = 2
    stuff = 0
    for i in range(total):
        if i < header_bits:
            bit = (header >> (header_bits - 1 - i)) & 1
        elif i < checked:
            at = i - header_bits
            bit = (int(np.int64(frames[row, 8 + (at >> 3)])) >> (7 - (at & 7))) & 1
        else:
            bit = (crc >> (total - 1 - i)) & 1
        if i < checked:
            feedback = bit ^ (crc >> 14)
            crc = (crc << 1) & 0x7FFF
            if feedback:
                crc ^= _CRC_POLYNOMIAL
        if bit == last:
            run += 1
        else:
            last = bit
            run = 1
        if run == 5:
            stuff += 1
            last = 1 - bit  # the stuff bit opens a run of its own
            run = 1
    return total + stuff + _UNSTUFFED


@numba.njit("void(uint8[:, ::1], int64, int64[::1], float64, float64[::1])", cache=True)
def charge(
    frames: Frames,
    count: int,
    totals: NDArray[np.int64],
    bit_s: float,
    latency: NDArray[np.float64],
) -> None:
    """Add the bits of the first ``count`` frames to ``totals``.

    Args:
        frames: Classical batch, uint8, shape ``(capacity, 16)``, in wire order, ready together.
        count: Rows to charge for.
        totals: Written in place, shape ``(4,)``: frames, nominal, exact, worst-case bits.
        bit_s: Length of a bit, s.
        latency: Longest time until a frame was through, s, by 11-bit identifier, raised in
            place, shape ``(2048,)``.
    """
    elapsed = 0
    for row in range(count):
        extended = frames[row, 3] >> 7
        stuffed = (_STUFFED_29 if extended else _STUFFED_11) + 8 * data_bytes(frames, row)
        totals[0] += 1
        totals[1] += stuffed + _UNSTUFFED
        exact = exact_bits(frames, row)
        totals[2] += exact
        totals[3] += stuffed + _UNSTUFFED + (stuffed - 1) // 4
        elapsed += exact
        if not extended:
            number = can_id(frames, row) & 0x7FF
            latency[number] = max(latency[number], elapsed * bit_s)
