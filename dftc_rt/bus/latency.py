"""How long a frame takes at most to get over its bus: response times of a CiA 402 cycle.

A frame that is ready waits for at most one frame of lower priority, which has just begun,
and for every frame of higher priority that is or becomes ready before it begins itself
(docs/bus.md, "Latency"). Everything counts with the most stuffing. Times are in bits, the
intermission included.

What the frames of a cycle depend on is used where it makes the bound smaller:

* SYNC is ready at the tick, once a cycle.
* TPDO1 and TPDO3 are ready when their SYNC has gone, so that very SYNC is not in their way
  again. Their latency counts from the tick.
* Commands are handed over together once the answers are there, and in time: early enough
  to be gone before the next SYNC. Their latency says how early that is. To the others
  they may come anywhere in the cycle.
* Everything else comes when it likes, at least its period apart.

Source: [davis2007] section 3 (eqs. for queueing delay, busy period and number of instances).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, Literal

from dftc_rt.bus import budget
from dftc_rt.bus.bits import nominal_bits, worst_bits

Origin = Literal["tick", "sync", "controller", "any"]

_SYNC: Final = 0x080
_EMCY: Final = 0x080
_TPDO1: Final = 0x180
_RPDO1: Final = 0x200
_TPDO2: Final = 0x280
_TPDO3: Final = 0x380
_SDO_RESPONSE: Final = 0x580
_SDO_REQUEST: Final = 0x600
_HEARTBEAT: Final = 0x700
_CONTROLLER_NODE: Final = 127

_HORIZON_S: Final = 1.0  # a frame that takes longer counts as one that never comes through


@dataclass(frozen=True, slots=True)
class Stream:
    """Frames of one identifier.

    Attributes:
        name: Kind of frame, as in the budget.
        can_id: Identifier; the lower has priority.
        bits: Longest frame; of CAN FD in bits of the bit rate.
        period: Least distance of two frames at their source, bits.
        origin: What makes it ready.
        jitter: Most by which that may come late against its period, bits.
    """

    name: str
    can_id: int
    bits: int | Fraction
    period: Fraction
    origin: Origin
    jitter: Fraction = Fraction(0)


@dataclass(frozen=True, slots=True)
class Latency:
    """Longest way of one stream's frames over the bus.

    Attributes:
        stream: Which.
        bits: From the tick (SYNC and what waits for it) or from when the frame is handed
            over, to its end; None: over a second, or no bound at all.
    """

    stream: Stream
    bits: Fraction | None


def cia402_streams(
    node_ids: Sequence[int], *, rate_hz: float, bitrate: int, emergencies: bool
) -> list[Stream]:
    """Return what travels on a CiA 402 bus in operation, by priority.

    Args:
        node_ids: Drives on the bus.
        rate_hz: Cycles per second.
        bitrate: Bits per second.
        emergencies: Whether the drives report emergencies too, all at once if it comes to
            that; the first of them ends a run.
    """
    cycle = Fraction(bitrate) / Fraction(rate_hz)

    def every(per_s: float) -> Fraction:
        return Fraction(bitrate) / Fraction(per_s)

    long, highest = worst_bits(8), max(node_ids)
    # SYNC is late by a frame that has just begun; its own length varies by its stuffing.
    spread = Fraction(long + worst_bits(1) - nominal_bits(1))
    streams = [Stream("SYNC with counter", _SYNC, worst_bits(1), cycle, "tick")]
    for node in node_ids:
        streams += [
            Stream("TPDO1 position, velocity", _TPDO1 + node, long, cycle, "sync", spread),
            Stream("RPDO1 command", _RPDO1 + node, worst_bits(4), cycle, "controller", cycle),
            Stream("TPDO2 statusword, mode", _TPDO2 + node, worst_bits(3),
                   every(budget.STATUS_PER_S), "any"),
            Stream("TPDO3 torque", _TPDO3 + node, worst_bits(2),
                   budget.TORQUE_EVERY * cycle, "sync", spread),
            Stream("heartbeat", _HEARTBEAT + node, worst_bits(1),
                   every(budget.HEARTBEATS_PER_S), "any"),
        ]  # fmt: skip
        if emergencies:
            rare = every(budget.EMERGENCIES_PER_S)
            streams.append(Stream("EMCY", _EMCY + node, long, rare, "any"))
    # One client, one transfer at a time: with the drive whose frames yield to all others'.
    sdo = every(budget.SDO_TRANSFERS_PER_S)
    heartbeat = every(budget.MASTER_HEARTBEATS_PER_S)
    streams += [
        Stream("SDO response", _SDO_RESPONSE + highest, long, sdo, "any"),
        Stream("SDO request", _SDO_REQUEST + highest, long, sdo, "any"),
        Stream("controller heartbeat", _HEARTBEAT + _CONTROLLER_NODE, worst_bits(1),
               heartbeat, "any", cycle),
    ]  # fmt: skip
    return sorted(streams, key=lambda stream: stream.can_id)


def latencies(streams: Sequence[Stream], bitrate: int) -> list[Latency]:
    """Return the longest way of every stream's frames.

    Args:
        streams: Everything on one bus, one of them of origin ``tick``.
        bitrate: Bits per second.
    """
    (sync,) = (stream for stream in streams if stream.origin == "tick")
    horizon = Fraction(bitrate) * Fraction(_HORIZON_S)
    start = _response(sync, streams, Fraction(0), horizon)
    return [Latency(each, _response(each, streams, start, horizon)) for each in streams]


def _response(
    stream: Stream, streams: Sequence[Stream], sync: Fraction | None, horizon: Fraction
) -> Fraction | None:
    """Response time of one stream, bits: the largest of all instances in its busy period.

    Args:
        stream: Whose.
        streams: Everything on the bus.
        sync: Longest way of SYNC from the tick.
        horizon: Longest that is looked for.
    """
    if sync is None:
        return None
    higher = [each for each in streams if each.can_id < stream.can_id]
    blocking = max((each.bits for each in streams if each.can_id > stream.can_id), default=0)
    if stream.origin == "controller":  # one hand-over, and gone before the next tick
        instances = 1
    else:
        load = sum((each.bits / each.period for each in [*higher, stream]), Fraction(0))
        if load >= 1:
            return None
        busy = Fraction(blocking)
        while True:
            own = math.ceil((busy + stream.jitter + 1) / stream.period)
            more = blocking + own * stream.bits + _ahead(higher, stream, busy, sync)
            if more == busy:
                break
            busy = more
            if busy > horizon:
                return None
        instances = own
    late = sync if stream.origin == "sync" else Fraction(0)
    longest = Fraction(0)
    wait = Fraction(blocking)
    for instance in range(instances):
        wait = max(wait, Fraction(blocking + instance * stream.bits))
        while True:
            more = blocking + instance * stream.bits + _ahead(higher, stream, wait, sync)
            if more == wait:
                break
            wait = more
            if wait > horizon:
                return None
        ready = instance * stream.period
        if instance and stream.origin != "sync":  # that counts from the tick, this from its own
            ready -= stream.jitter
        longest = max(longest, late + wait + stream.bits - ready)
    return longest


def _ahead(higher: Sequence[Stream], stream: Stream, wait: Fraction, sync: Fraction) -> Fraction:
    """Bits of higher priority that come before ``stream`` begins, ``wait`` after it was ready."""
    bits = (_instances(each, stream, wait, sync) * each.bits for each in higher)
    return Fraction(sum(bits))


def _instances(each: Stream, stream: Stream, wait: Fraction, sync: Fraction) -> int:
    """How many frames of ``each`` are ready before ``stream`` begins, ``wait`` after it was."""
    if stream.origin == "controller" and each.origin != "any":
        return 1 if each.origin == "controller" else 0
    window = wait + each.jitter + 1  # one bit time: ready just before the other begins
    if stream.origin == "sync":
        if each.origin == "tick":  # the one that it waited for has gone
            return math.ceil((wait + sync + 1) / each.period) - 1
        window += sync
    return math.ceil(window / each.period)
