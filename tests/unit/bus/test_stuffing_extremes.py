"""Frames that need the least and the most stuffing there is, counted to the bit.

The bounds of the budget are the literature's: no stuff bit, and one for every four bits
after the first. The first is reached from four data bytes on; below, RTR, IDE, r0 and the
upper bits of the length code are five zeros in a row, so that one stuff bit is in every
frame. The second is never reached: a pattern that stuffs every fourth bit does not fit
around the fixed bits of the header, nor does the CRC go along with it. By how much it
fails is found in ``stuffing.py`` among all identifiers and payloads.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from dftc_rt.bus.bits import exact_bits, nominal_bits, worst_bits
from dftc_rt.bus.frame import EFF_FLAG, Frames, frame_buffer, pack
from tests.unit.bus.stuffing import extreme

EVERY = list(product(range(9), (False, True)))
# Bits by which the longest frame is shorter than the bound, by data bytes. docs/bus.md says so.
SHORT_OF_WORST = {False: (2, 3, 3, 2, 2, 3, 2, 1, 2), True: (2,) * 9}


def one(can_id: int, data: bytes) -> Frames:
    frames = frame_buffer(1)
    frames[0] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    return frames


@pytest.mark.parametrize(("length", "extended"), EVERY)
def test_the_frame_with_the_fewest_stuff_bits(length: int, extended: bool) -> None:
    found = extreme(length, extended=extended, most=False)
    assert found.stuff == (1 if length < 4 else 0)
    frame = one(found.can_id | (EFF_FLAG if extended else 0), found.data)
    assert exact_bits(frame, 0) == nominal_bits(length, extended) + found.stuff


@pytest.mark.parametrize(("length", "extended"), EVERY)
def test_the_frame_with_the_most_stuff_bits(length: int, extended: bool) -> None:
    found = extreme(length, extended=extended, most=True)
    frame = one(found.can_id | (EFF_FLAG if extended else 0), found.data)
    bits = exact_bits(frame, 0)
    assert bits == nominal_bits(length, extended) + found.stuff
    assert worst_bits(length, extended) - bits == SHORT_OF_WORST[extended][length]


@pytest.mark.parametrize("length", [0, 1])
def test_every_short_frame_one_by_one(length: int) -> None:
    # 2048 frames without data, 524288 with one byte: nothing is left to believe.
    frames = frame_buffer(2048 * 256**length)
    number = np.arange(len(frames))
    identifiers = (number % 2048).astype("<u4")
    frames[:, :4] = identifiers.view(np.uint8).reshape(-1, 4)
    frames[:, 4] = length
    frames[:, 8] = number // 2048
    found = {exact_bits(frames, row) for row in range(len(frames))}
    least = extreme(length, extended=False, most=False).stuff
    most = extreme(length, extended=False, most=True).stuff
    assert (min(found), max(found)) == (nominal_bits(length) + least, nominal_bits(length) + most)


# SYNC with the counter at 1, worked by hand; stuff bits in brackets, bars between SOF,
# identifier, RTR IDE r0, length code, data and CRC:
#   0 00010000000 000 0001 00000001, whose ones are x^22, x^8 and x^0 of 27 bits. Times x^15:
#   x^37 + x^23 + x^15, and with x^15 = 0x4599 and doubling (test_bits.py has up to x^29):
#   x^29 = 0x1C05, 0x380A, 0x7014, 0x25B1, 0x4B62, 0x535D, 0x6323, 0x03DF, x^37 = 0x07BE,
#   x^23 = 0x4426. The CRC is 0x07BE ^ 0x4426 ^ 0x4599 = 0x0601 = 000011000000001.
_SYNC = "0|000100000(1)00|000(1)|0001|00000(1)001|00001100000(1)0001"


def test_a_sync_worked_by_hand() -> None:
    wire = _SYNC.translate({ord(mark): None for mark in "()|"})
    assert len(wire) == 27 + 15 + 4
    assert exact_bits(one(0x080, b"\x01"), 0) == len(wire) + 13
