"""How long a frame takes at most where each drive answers its command, and nothing else is sent.

All commands of a bus are handed over at the tick. At the end of every frame the most urgent of
those that wait is next: the commands that have not gone, and the answers to those that have. So
the bus is never idle before the last answer, and the order of a cycle is always the same. Every
frame counts with the most stuffing; longer frames change no order, since an answer is ready when
its command ends. A drive's own reaction time comes on top, as in :mod:`dftc_rt.bus.latency`.

Source: ISO 11898-1:2015, "Arbitration".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from dftc_rt.bus.frame import EFF_FLAG, EFF_MASK
from dftc_rt.bus.latency import Latency, Stream


@dataclass(frozen=True, slots=True)
class Polled:
    """The two frames of one drive.

    Attributes:
        command: Identifier of its commands, with EFF_FLAG where it has 29 bits.
        answer: Identifier of its answers, likewise.
    """

    command: int
    answer: int


def arbitration(can_id: int) -> int:
    """Return what the bits of an identifier are worth on the wire; the lower wins.

    11 bits of identifier, RTR or SRR, IDE, 18 bits: of two identifiers with the same first 11
    bits the shorter wins.
    """
    if can_id & EFF_FLAG:
        number = can_id & EFF_MASK
        return number >> 18 << 20 | 3 << 18 | (number & 0x3FFFF)
    return can_id << 20


def mit_frames(node_ids: Sequence[int], host_id: int) -> list[Polled]:
    """Return the identifiers of MIT drives."""
    return [Polled(node, host_id) for node in node_ids]


def moteus_frames(node_ids: Sequence[int], host_id: int) -> list[Polled]:
    """Return the identifiers of moteus drives."""
    return [
        Polled(_long(0x8000 | host_id << 8 | node), _long(node << 8 | host_id)) for node in node_ids
    ]


def _long(number: int) -> int:
    """Return an identifier with EFF_FLAG where 11 bits do not hold it."""
    return number | EFF_FLAG if number > 0x7FF else number


def polled_latencies(
    drives: Sequence[Polled], command_bits: float, answer_bits: float, period_bits: float
) -> list[Latency]:
    """Return the longest way of every frame, from the tick to its end, in order of the wire.

    Args:
        drives: The drives of one bus.
        command_bits: Longest command, in bits of the bit rate.
        answer_bits: Longest answer, likewise.
        period_bits: Length of a cycle; a bus that needs more has no bound.
    """
    lengths = {True: Fraction(command_bits), False: Fraction(answer_bits)}
    period = Fraction(period_bits)
    full = len(drives) * sum(lengths.values()) > period
    waiting = [(arbitration(each.command), k, True) for k, each in enumerate(drives)]
    found = []
    at = Fraction(0)
    while waiting:
        head = min(waiting)
        waiting.remove(head)
        _, k, is_command = head
        at += lengths[is_command]
        if is_command:
            waiting.append((arbitration(drives[k].answer), k, False))
        name, can_id = (
            ("command", drives[k].command) if is_command else ("answer", drives[k].answer)
        )
        stream = Stream(name, can_id, lengths[is_command], period, "tick")
        found.append(Latency(stream, None if full else at))
    return found
