"""How many bits a CAN FD frame takes on the wire, of either bit rate.

Up to and including BRS, and from the CRC delimiter on, bits last as on a classical bus; those
between, from ESI to the end of the CRC, last as long as the data bit rate says, when BRS is
recessive. Bits from SOF to the last data bit are stuffed as in a classical frame. The CRC field,
a stuff count of 4 bits and 17 or (over 16 data bytes) 21 bits of CRC, has a fixed stuff bit before
it and one behind every fourth bit, so that its content does not matter here.

    arbitration    SOF, 11 identifier, RRS, IDE, FDF, res, BRS               17
                   29 bits: SOF, 11, SRR, IDE, 18, RRS, FDF, res, BRS        36
    data           ESI, 4 length code, 8 n data                              5 + 8 n
                   fixed stuff bits, stuff count, CRC                        27 or 32
    end            CRC delimiter, ACK, its delimiter, 7 EOF, 3 intermission  13

Source: ISO 11898-1:2015, "CAN FD frames"; Bosch, CAN with Flexible Data-Rate 1.0 (2012).
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.bits import charge
from dftc_rt.bus.fields import can_id
from dftc_rt.bus.frame import BRS, ESI, FD_LENGTHS, FDF, Frames

_ARBITRATION_11: Final = 17
_ARBITRATION_29: Final = 36
_CONTROL: Final = 5
_CRC_17: Final = 27
_CRC_21: Final = 32
_END: Final = 13
_LONG: Final = 16  # data bytes above which the CRC has 21 bits
_LENGTHS = np.array(FD_LENGTHS, dtype=np.int64)


def fd_length(data_bytes: int) -> int:
    """Return the shortest length that an FD frame can have for so many bytes, 0 … 64."""
    return next(length for length in FD_LENGTHS if length >= data_bytes)


def nominal_fd_bits(length: int, extended: bool = False) -> tuple[int, int]:
    """Return the bits of a frame without any stuffing, intermission included.

    Args:
        length: Data bytes, one of :data:`~dftc_rt.bus.frame.FD_LENGTHS`.
        extended: 29-bit identifier.

    Returns:
        Bits at the bit rate, bits at the data bit rate.
    """
    arbitration = _ARBITRATION_29 if extended else _ARBITRATION_11
    crc = _CRC_21 if length > _LONG else _CRC_17
    return arbitration + _END, _CONTROL + 8 * length + crc


def worst_fd_bits(length: int, extended: bool = False) -> tuple[int, int]:
    """Return the bits of a frame with the most stuffing that its length allows.

    A stuff bit lasts longest before the switch of the rate, so as many as can be are counted
    there: behind the fifth bit and every fourth from then on. None follows the last data bit,
    where the fixed one is.

    Args:
        length: Data bytes, one of :data:`~dftc_rt.bus.frame.FD_LENGTHS`.
        extended: 29-bit identifier.

    Returns:
        Bits at the bit rate, bits at the data bit rate.
    """
    slow, fast = nominal_fd_bits(length, extended)
    before = slow - _END
    stuffed = before + _CONTROL + 8 * length
    early = (before - 2) // 4  # one that BRS completes comes behind it
    every = (stuffed - 2) // 4
    return slow + early, fast + every - early


@numba.njit("UniTuple(int64, 2)(uint8[:, ::1], int64)", cache=True)
def exact_fd_bits(frames: Frames, row: int) -> tuple[int, int]:
    """Return the bits of the FD frame in ``row``: its own stuffing, intermission included.

    Args:
        frames: FD batch, uint8, shape ``(capacity, 72)``.
        row: Row to look at; its length is one of :data:`~dftc_rt.bus.frame.FD_LENGTHS`.

    Returns:
        Bits at the bit rate, bits at the data bit rate; without BRS all at the bit rate.
    """
    identifier: int = can_id(frames, row)
    length = int(np.int64(frames[row, 4]))
    flags = int(np.int64(frames[row, 5]))
    brs = flags & BRS
    code = 0
    while _LENGTHS[code] < length:
        code += 1
    if identifier >> 31:
        header = ((identifier >> 18) & 0x7FF) << 2 | 3  # SRR and IDE recessive
        header = header << 18 | (identifier & 0x3FFFF)
        header = header << 4 | 4 | brs  # RRS dominant, FDF recessive, res dominant
        before = _ARBITRATION_29
    else:
        header = (identifier & 0x7FF) << 5 | 4 | brs  # RRS, IDE dominant, FDF, res, BRS
        before = _ARBITRATION_11
    header = header << 5 | (flags & ESI) << 3 | code
    header_bits = before + _CONTROL
    total = header_bits + 8 * length
    early = 0
    late = 0
    run = 0
    last = 2
    for i in range(total - 1):  # behind the last bit is a fixed stuff bit in any case
        if i < header_bits:
            bit = (header >> (header_bits - 1 - i)) & 1
        else:
            at = i - header_bits
            bit = (int(np.int64(frames[row, 8 + (at >> 3)])) >> (7 - (at & 7))) & 1
        if bit == last:
            run += 1
        else:
            last = bit
            run = 1
        if run == 5:
            if i + 1 < before:
                early += 1
            else:
                late += 1
            last = 1 - bit  # the stuff bit opens a run of its own
            run = 1
    slow = before + early + _END
    fast = total - before + late + (_CRC_21 if length > _LONG else _CRC_17)
    if brs:
        return slow, fast
    return slow + fast, 0


@numba.njit("void(float64[:, ::1], int64, float64)", cache=True)
def raise_extended(extended: NDArray[np.float64], number: int, elapsed: float) -> None:
    """Raise the latency of a 29-bit identifier, which takes the first free place once."""
    for k in range(extended.shape[1]):
        if extended[1, k] == 0.0:
            extended[0, k] = number
        if extended[0, k] == number:
            extended[1, k] = max(extended[1, k], elapsed)
            return


@numba.njit(
    "void(uint8[:, ::1], int64, int64[::1], float64, float64, float64[::1], float64[:, ::1])",
    cache=True,
)
def charge_fd(
    frames: Frames,
    count: int,
    totals: NDArray[np.int64],
    bit_s: float,
    data_bit_s: float,
    latency: NDArray[np.float64],
    extended: NDArray[np.float64],
) -> None:
    """Add the bits of the first ``count`` frames of a bus that carries FD frames to ``totals``.

    Args:
        frames: FD batch, uint8, shape ``(capacity, 72)``, classical frames among them.
        count: Rows to charge for.
        totals: Written in place, shape ``(7,)``: frames; nominal, exact, worst-case bits at the
            bit rate; the same at the data bit rate.
        bit_s: Length of a bit, s.
        data_bit_s: Length of a bit of the data part, s.
        latency: Longest time until a frame was through, s, by 11-bit identifier, raised in
            place, shape ``(2048,)``.
        extended: The same of FD frames with 29 bits, shape ``(2, k)``: identifier; longest time,
            0 where the place is free. Identifiers beyond the first k are left out.
    """
    one = np.zeros(4, dtype=np.int64)
    elapsed = 0.0
    for row in range(count):
        number = can_id(frames, row) & 0x7FF
        if not frames[row, 5] & FDF:
            one[:] = 0
            charge(frames[row : row + 1], 1, one, bit_s, latency)
            totals[:4] += one
            elapsed += one[2] * bit_s
            if not frames[row, 3] >> 7:
                latency[number] = max(latency[number], elapsed)
            continue
        length = int(np.int64(frames[row, 4]))
        before = _ARBITRATION_29 if frames[row, 3] >> 7 else _ARBITRATION_11
        slow = before + _END
        fast = _CONTROL + 8 * length + (_CRC_21 if length > _LONG else _CRC_17)
        early = (before - 2) // 4
        late = (before + _CONTROL + 8 * length - 2) // 4 - early
        brs = frames[row, 5] & BRS
        exact, exact_fast = exact_fd_bits(frames, row)
        totals[0] += 1
        totals[1] += slow if brs else slow + fast
        totals[2] += exact
        totals[3] += slow + early if brs else slow + fast + early + late
        totals[4] += fast if brs else 0
        totals[5] += exact_fast
        totals[6] += fast + late if brs else 0
        elapsed += exact * bit_s + exact_fast * data_bit_s
        if frames[row, 3] >> 7:
            raise_extended(extended, can_id(frames, row) & 0x1FFFFFFF, elapsed)
        else:
            latency[number] = max(latency[number], elapsed)
