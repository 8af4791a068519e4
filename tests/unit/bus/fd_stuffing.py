"""Longest and shortest CAN FD frame of a length, found among all identifiers and payloads.

Stuff bits of an FD frame end with its data; the CRC field has fixed ones. So what has gone matters
to what follows only through the current run of equal bits: 8 states, and a frame falls out.
"""

from __future__ import annotations

from dataclasses import dataclass

from dftc_rt.bus.frame import FD_LENGTHS

State = tuple[int, int]  # last bit on the wire, length of its run


@dataclass(frozen=True)
class Extreme:
    """The frame that takes longest, or shortest.

    Attributes:
        slow: Stuff bits at the bit rate.
        fast: Stuff bits at the data bit rate.
        can_id: Its identifier, without flags.
        data: Its data.
    """

    slow: int
    fast: int
    can_id: int
    data: bytes


def _layout(length: int, extended: bool) -> tuple[list[int | None], int]:
    """Bits from SOF to the last of the data, None where they are free; how many up to BRS."""
    if extended:
        arbitration = [0, *[None] * 11, 1, 1, *[None] * 18, 0, 1, 0, 1]  # SRR IDE … RRS FDF res BRS
    else:
        arbitration = [0, *[None] * 11, 0, 0, 1, 0, 1]  # RRS IDE FDF res BRS
    code = [int(bit) for bit in format(FD_LENGTHS.index(length), "04b")]
    return [*arbitration, 0, *code, *[None] * (8 * length)], len(arbitration)


def extreme(length: int, *, extended: bool, most: bool, ratio: int) -> Extreme:
    """Return the frame that takes longest (or shortest).

    Args:
        length: Data bytes.
        extended: 29-bit identifier.
        most: Longest, not shortest.
        ratio: Data bit rate over bit rate.
    """
    layout, before = _layout(length, extended)
    sign = 1 if most else -1
    # state -> worth, (slow, fast), bits so far
    paths: dict[State, tuple[int, tuple[int, int], list[int]]] = {(0, 1): (0, (0, 0), [0])}
    for place, fixed in enumerate(layout[1:], start=1):
        fresh: dict[State, tuple[int, tuple[int, int], list[int]]] = {}
        for (last, run), (_, (slow, fast), bits) in paths.items():
            for bit in (0, 1) if fixed is None else (fixed,):
                length_now = run + 1 if bit == last else 1
                state, now = (bit, length_now), (slow, fast)
                if length_now == 5 and place < len(layout) - 1:  # none behind the last data bit
                    # The rate changes within BRS: a stuff bit behind it is short.
                    now = (slow + 1, fast) if place < before - 1 else (slow, fast + 1)
                    state = (1 - bit, 1)
                elif length_now == 5:
                    state = (bit, 4)  # nothing follows that could tell
                value = sign * (now[0] * ratio + now[1])
                if state not in fresh or value > fresh[state][0]:
                    fresh[state] = (value, now, [*bits, bit])
        paths = fresh
    _, (slow, fast), bits = max(paths.values(), key=lambda path: path[0])
    free = [bit for bit, fixed in zip(bits, layout, strict=True) if fixed is None]
    size = 29 if extended else 11
    number = int("".join(map(str, free[:size])), 2)
    data = int("0" + "".join(map(str, free[size:])), 2).to_bytes(length, "big")
    return Extreme(slow, fast, number, data)
