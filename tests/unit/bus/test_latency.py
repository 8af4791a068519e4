"""Response times: an example of the literature, sums by hand, and a bus that is played through."""

from __future__ import annotations

import heapq
import math
import random
from fractions import Fraction

import pytest

from dftc_rt.bus.latency import Stream, cia402_streams, latencies
from dftc_rt.drives.cia402 import objects as od

RATE, BITRATE = 1000.0, 1_000_000


def longest(streams: list[Stream]) -> dict[int, float | None]:
    return {
        each.stream.can_id: None if each.bits is None else float(each.bits)
        for each in latencies(streams, BITRATE)
    }


def test_the_example_that_refuted_the_first_analysis() -> None:
    # Davis, Burns, Bril, Lukkien (2007), section 3: three frames of 125 bits at 125 kbit/s,
    # every 2.5, 3.5 and 3.5 ms. The last one's second instance takes 3.5 ms, its first 3.
    ms = 125
    streams = [
        Stream("A", 1, ms, Fraction(5 * ms, 2), "tick"),
        Stream("B", 2, ms, Fraction(7 * ms, 2), "any"),
        Stream("C", 3, ms, Fraction(7 * ms, 2), "any"),
    ]
    assert longest(streams) == {1: 2.0 * ms, 2: 3.0 * ms, 3: 3.5 * ms}


def test_three_joints_by_hand() -> None:
    streams = cia402_streams([1, 2, 3], rate_hz=RATE, bitrate=BITRATE, emergencies=False)
    found = longest(streams)
    assert [stream.can_id for stream in streams] == sorted(found)
    # SYNC behind the longest frame that may have begun; answers behind SYNC, one more such
    # frame that begins before a drive is ready, and each other.
    assert found[0x080] == 135 + 65
    assert [found[0x180 + node] for node in (1, 2, 3)] == [200 + 135 + k * 135 for k in (1, 2, 3)]
    # Commands behind one frame and each other.
    assert [found[0x200 + node] for node in (1, 2, 3)] == [135 + k * 95 for k in (1, 2, 3)]


def test_the_lowest_priority_is_blocked_by_nothing() -> None:
    # Half a load, so that one instance is all there is: SYNC and two frames before the last.
    streams = [
        Stream("SYNC", 0x080, 65, Fraction(1000), "tick"),
        Stream("a", 0x100, 135, Fraction(5000), "any"),
        Stream("b", 0x200, 95, Fraction(5000), "any"),
    ]
    assert longest(streams) == {0x080: 200.0, 0x100: 95 + 65 + 135, 0x200: 65 + 135 + 95}


def test_an_emergency_of_every_drive_comes_before_the_answers() -> None:
    quiet = longest(cia402_streams([1, 2], rate_hz=500.0, bitrate=BITRATE, emergencies=False))
    streams = cia402_streams([1, 2], rate_hz=500.0, bitrate=BITRATE, emergencies=True)
    found = longest(streams)
    assert found[0x182] == quiet[0x182] + 2 * 135
    assert found[0x202] == quiet[0x202] + 2 * 135
    assert found[0x080] == quiet[0x080]


def test_a_bus_that_is_full_has_no_bound() -> None:
    streams = cia402_streams([1, 2, 3, 4, 5], rate_hz=RATE, bitrate=BITRATE, emergencies=False)
    found = longest(streams)
    assert found[0x080] == 200.0
    assert found[0x385] is None
    assert found[0x77F] is None


def test_the_identifiers_are_those_of_the_drives() -> None:
    streams = cia402_streams([5, 9], rate_hz=RATE, bitrate=BITRATE, emergencies=True)
    found = {stream.can_id for stream in streams}
    bases = (od.EMCY, od.TPDO[0], od.RPDO[0], od.TPDO[1], od.TPDO[2], od.HEARTBEAT)
    expected = {base + node for base in bases for node in (5, 9)}
    # SDO: one channel at a time, with the drive of the lowest priority.
    expected |= {od.SYNC, od.SDO_RESPONSE + 9, od.SDO_REQUEST + 9}
    assert found == expected | {od.HEARTBEAT + od.MASTER_NODE_ID}


# -- a bus, played through -------------------------------------------------------------------


class Bus:
    """Frames with random lengths and phases, arbitrated one by one; times in bits."""

    def __init__(self, streams: list[Stream], seed: int, reaction: int) -> None:
        self._random = random.Random(seed)
        self._streams = streams
        self._reaction = reaction
        self._bound = {each.stream.can_id: each.bits for each in latencies(streams, BITRATE)}
        self._future: list[tuple[float, int, int, Stream, float]] = []
        self._count = 0
        self.longest = dict.fromkeys(self._bound, 0.0)

    def _schedule(self, at: float, stream: Stream, since: float) -> None:
        self._count += 1
        heapq.heappush(self._future, (at, stream.can_id, self._count, stream, since))

    def play(self, cycles: int) -> None:
        """Run; ``longest`` has each stream's longest way from where its bound counts."""
        by_origin = {
            origin: [s for s in self._streams if s.origin == origin]
            for origin in ("tick", "sync", "controller", "any")
        }
        (sync,) = by_origin["tick"]
        period = float(sync.period)
        in_time = max(float(self._bound[s.can_id] or 0) for s in by_origin["controller"])
        for cycle in range(cycles):
            self._schedule(cycle * period, sync, cycle * period)
        for stream in by_origin["any"]:
            self._sporadic(stream, cycles * period)
        waiting: list[tuple[int, int, Stream, float]] = []
        answered = last = -1
        now = 0.0
        while self._future or waiting:
            if not waiting:
                now = max(now, self._future[0][0])
            while self._future and self._future[0][0] <= now:
                _, can_id, count, stream, since = heapq.heappop(self._future)
                heapq.heappush(waiting, (can_id, count, stream, since))
            if not waiting:
                continue
            _, _, stream, since = heapq.heappop(waiting)
            now += stream.bits if self._random.random() < 0.8 else stream.bits - 10
            self.longest[stream.can_id] = max(self.longest[stream.can_id], now - since)
            if stream.origin == "tick":
                cycle = round(since / period)
                for answer in by_origin["sync"]:
                    every = round(float(answer.period) / period)
                    if cycle % every == answer.can_id % every:
                        late = self._random.randint(0, self._reaction)
                        self._schedule(now + late, answer, since + late)
                answered = 0
            elif stream.origin == "sync" and stream.period == sync.period:
                answered += 1
                cycle = math.floor(since / period)
                if answered == len(by_origin["controller"]) and cycle > last:
                    last = cycle
                    latest = (cycle + 1) * period - in_time
                    if latest > now:  # else they would not be in time, and nothing is claimed
                        at = self._random.choice([now, latest, self._random.uniform(now, latest)])
                        for command in by_origin["controller"]:
                            self._schedule(at, command, at)

    def _sporadic(self, stream: Stream, end: float) -> None:
        """As often as allowed, from a random phase on, often just before a tick."""
        tick = float(self._streams[0].period)
        at = self._random.choice([self._random.uniform(0, float(stream.period)), tick - 1, tick])
        while at < end:
            self._schedule(at, stream, at)
            at += float(stream.period) + self._random.choice(
                [0.0, 0.0, self._random.uniform(0, 300)]
            )


@pytest.mark.parametrize("emergencies", [False, True])
@pytest.mark.parametrize("nodes", [[1, 2], [1, 2, 3]])
def test_no_frame_ever_takes_longer(nodes: list[int], emergencies: bool) -> None:
    streams = cia402_streams(nodes, rate_hz=RATE, bitrate=BITRATE, emergencies=emergencies)
    bound = longest(streams)
    seen = dict.fromkeys(bound, 0.0)
    for seed in range(20):
        bus = Bus(streams, seed, reaction=0 if seed % 2 else 40)
        bus.play(300)
        for can_id, took in bus.longest.items():
            assert took <= bound[can_id] + 1e-6, (seed, hex(can_id))
            seen[can_id] = max(seen[can_id], took)
    assert seen[0x080] > 0.99 * bound[0x080]
    if not emergencies:  # the bound of what matters is what does happen
        for node in nodes:
            assert seen[0x180 + node] > 0.9 * bound[0x180 + node]
            assert seen[0x200 + node] > 0.9 * bound[0x200 + node]
