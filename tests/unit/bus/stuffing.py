"""Fewest and most stuff bits of any frame of a length, found among all of them.

Dynamic programming over the bits of a frame: what has gone matters to what follows only
through the CRC register and the current run of equal bits, which is 32768 · 8 states. Every
identifier and every payload is among the paths, so the extremes are exact, and one frame
that attains them falls out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_POLYNOMIAL = 0x4599
_CRCS = 1 << 15
_FREE = None
_NEVER = -1000  # more than a frame has bits

# Value of the last bit on the wire (0, 1) and length of its run (1 to 4): 8 states.
_STATES = [(last, run) for last in (0, 1) for run in (1, 2, 3, 4)]
_REGISTERS = np.arange(_CRCS)


@dataclass(frozen=True)
class Extreme:
    """The frame with the most or the fewest stuff bits.

    Attributes:
        stuff: How many.
        can_id: Its identifier, without flags.
        data: Its data.
    """

    stuff: int
    can_id: int
    data: bytes


def _after(state: int, bit: int) -> tuple[int, int]:
    """Return (state, stuff bits) after one more bit."""
    last, run = _STATES[state]
    run = run + 1 if bit == last else 1
    if run == 5:
        return _STATES.index((1 - bit, 1)), 1
    return _STATES.index((bit, run)), 0


_STEP = [[_after(state, bit) for bit in (0, 1)] for state in range(8)]


def _register(bit: int) -> NDArray[np.int64]:
    """Return the CRC register after a bit, for every register before it."""
    feedback = (_REGISTERS >> 14) ^ bit
    return ((_REGISTERS << 1) & 0x7FFF) ^ (feedback * _POLYNOMIAL)


_NEXT = [_register(0), _register(1)]
_BEFORE = [np.argsort(table) for table in _NEXT]  # no two registers lead to the same one


def _layout(length: int, extended: bool) -> list[int | None]:
    """Bits from SOF to the end of the data; None where identifier and data are free."""
    if extended:
        identifier = [_FREE] * 11 + [1, 1] + [_FREE] * 18 + [0, 0, 0]  # SRR IDE … RTR r1 r0
    else:
        identifier = [_FREE] * 11 + [0, 0, 0]  # RTR IDE r0
    code = [int(bit) for bit in format(length, "04b")]
    return [0, *identifier, *code, *[_FREE] * (8 * length)]


def _stuff_of_crc() -> NDArray[np.int16]:
    """Stuff bits within the CRC, by (state, register)."""
    total = np.zeros((8, _CRCS), dtype=np.int16)
    step = np.array([[_STEP[s][b] for b in (0, 1)] for s in range(8)], dtype=np.int16)
    state = np.broadcast_to(np.arange(8)[:, None], (8, _CRCS))
    for place in range(14, -1, -1):
        bit = np.broadcast_to((_REGISTERS >> place) & 1, state.shape)
        total += step[state, bit, 1]
        state = step[state, bit, 0]
    return total


_TAIL = _stuff_of_crc()


def extreme(length: int, *, extended: bool, most: bool) -> Extreme:
    """Return the frame of ``length`` data bytes with the most (or fewest) stuff bits."""
    sign = 1 if most else -1  # the fewest are the most of the negative
    layout = _layout(length, extended)
    best = np.full((8, _CRCS), _NEVER, dtype=np.int16)
    best[_STATES.index((0, 1)), 0] = 0  # after SOF
    history = [best]
    for fixed in layout[1:]:
        fresh = np.full_like(best, _NEVER)
        for bit in (0, 1) if fixed is _FREE else (fixed,):
            came = best[:, _BEFORE[bit]]
            for state in range(8):
                after, stuff = _STEP[state][bit]
                np.maximum(fresh[after], came[state] + np.int16(sign * stuff), out=fresh[after])
        best = fresh
        history.append(best)
    value = best + sign * _TAIL
    state, register = np.unravel_index(int(np.argmax(value)), value.shape)
    stuff = sign * int(value[state, register])
    bits = _path(layout, history, int(register), int(state), sign)
    free = [bit for bit, fixed in zip(bits, layout, strict=True) if fixed is _FREE]
    identifier = free[: 29 if extended else 11]
    number = int("0" + "".join(map(str, free[len(identifier) :])), 2)
    return Extreme(stuff, int("".join(map(str, identifier)), 2), number.to_bytes(length, "big"))


def _path(
    layout: list[int | None],
    history: list[NDArray[np.int16]],
    register: int,
    state: int,
    sign: int,
) -> list[int]:
    """Walk back from a last state; return the bits from SOF on."""
    bits = []
    for place in range(len(layout) - 1, 0, -1):
        fixed = layout[place]
        found = next(
            (before, int(_BEFORE[bit][register]), bit)
            for bit in ((0, 1) if fixed is _FREE else (fixed,))
            for before in range(8)
            if _STEP[before][bit][0] == state
            and history[place - 1][before, _BEFORE[bit][register]] + sign * _STEP[before][bit][1]
            == history[place][state, register]
        )
        state, register, bit = found
        bits.append(bit)
    return [0, *reversed(bits)]
