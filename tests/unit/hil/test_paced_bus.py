"""Timing ``pace``: when each frame arrives, worked out by hand, with a clock of the test's own.

At 1 Mbit/s a bit is a microsecond, so that times are sums of the frames' bits; those are
``exact_bits``, which ``test_bits`` holds to hand-worked frames, and one is worked out here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from dftc_rt.bus.bits import exact_bits
from dftc_rt.bus.fd_bits import exact_fd_bits
from dftc_rt.bus.frame import Frames, frame_buffer, pack, pack_fd, unpack
from dftc_rt.bus.inprocess import InProcessSocket, link
from dftc_rt.config import faults as kinds
from dftc_rt.config.faults import BusFault
from dftc_rt.errors import InputError
from hil.bus.impairments import ERROR_BITS, Impairments
from hil.bus.paced_bus import MOST_WAITING, PacedBus
from hil.bus.paced_impairments import PacedImpairments
from hil.bus.statistics import EXACT, FRAMES, TOTALS, busy_s
from hil.bus.virtual_bus import unpaced
from hil.bus.wire import NEVER

US = 1_000
DATA = b"\x55" * 8  # alternating bits: no stuffing in the data


class Bench:
    """A paced bus, its nodes, and what each has heard when."""

    def __init__(
        self, nodes: int = 2, *faults: BusFault, bitrate: int = 1_000_000, data: int | None = None
    ) -> None:
        self.now = 0
        self.port = PacedBus("can0", bitrate=bitrate, data_bitrate=data, clock=lambda: self.now)
        self.nodes: list[InProcessSocket] = []
        self.heard: list[list[tuple[int, int]]] = []  # by node: (µs, identifier)
        self.drives: list[tuple[int, int]] = []
        for _ in range(nodes):
            node, end = link("can0", frame_size=self.port.frame_size)
            self.port.attach(end)
            self.nodes.append(node)
            self.heard.append([])
        if faults:
            self.port.impair(
                PacedImpairments("can0", faults, 1, 0, lambda *_: None, self.port.frame_size)
            )
            self.port.advance(0.0)

    def send(self, node: int, *frames: bytes) -> None:
        """Let a node send now."""
        rows = batch(frames, self.port.frame_size)
        assert self.nodes[node].send(rows, len(frames)) == len(frames)
        self.port.take_in()

    def run(self, until_us: float = NEVER // US) -> None:
        """Let time pass, serving the bus whenever something happens on the wire."""
        inbox = frame_buffer(4, self.port.frame_size)
        while self.port.due <= until_us * US:
            self.now = max(self.port.due, self.now)
            while self.port.receive(inbox):
                self.drives.append((self.port.moment // US, unpack(inbox[0].tobytes())[0]))
            for node, heard in zip(self.nodes, self.heard, strict=True):
                count = node.receive(inbox)
                heard += [(self.now // US, unpack(inbox[row].tobytes())[0]) for row in range(count)]
        if until_us < NEVER // US:
            self.now = int(until_us * US)


def batch(frames: Sequence[bytes], size: int = 16) -> Frames:
    rows = frame_buffer(len(frames), size)
    for row, raw in zip(rows, frames, strict=True):
        row[: len(raw)] = np.frombuffer(raw, dtype=np.uint8)
    return rows


def bits(*frames: bytes) -> int:
    return sum(exact_bits(batch([frame]), 0) for frame in frames)


LOW, MIDDLE, HIGH = pack(0x2AA, DATA), pack(0x155, DATA), pack(0x0AA, DATA)
"""By priority. Each has 111 bits without stuffing."""


def test_counts_are_kept_where_another_process_can_read_them() -> None:
    bench = Bench()
    bench.send(0, LOW)
    bench.run()
    shared = np.zeros(TOTALS, np.int64)
    bench.port.count_into(shared)
    assert (shared[FRAMES], shared[EXACT]) == (1, bits(LOW))  # what had been counted before
    bench.send(0, HIGH)
    bench.run()
    assert (shared[FRAMES], shared[EXACT]) == (2, bits(LOW, HIGH))
    assert bench.port.statistics.exact_bits == bits(LOW, HIGH)
    assert busy_s(shared, 1_000_000, 5_000_000) == pytest.approx(1e-6 * bits(LOW, HIGH))


def test_a_frame_arrives_when_its_bits_are_over() -> None:
    # 0x555 without data: 0 10101010101 0 0 0 0000, CRC. SOF and identifier alternate; then seven
    # zeros: one stuff bit behind the fifth. CRC-15 of 0 10101010101 0000000 is worked out below.
    frame = pack(0x555, b"")
    register = 0
    for bit in "0" + "10101010101" + "0000000":
        feedback = int(bit) ^ register >> 14
        register = (register << 1 & 0x7FFF) ^ (0x4599 if feedback else 0)
    wire = "0" + "10101010101" + "0000000" + f"{register:015b}"
    stuffed, run, last = 0, 0, ""
    for bit in wire:
        run, last = (run + 1, bit) if bit == last else (1, bit)
        if run == 5:
            stuffed, run, last = stuffed + 1, 1, "10"[int(bit)]
    took = 34 + stuffed + 13
    bench = Bench()
    bench.send(0, frame)
    bench.run(took - 0.001)
    assert bench.heard == [[], []]
    assert bench.drives == []
    bench.run(took)
    assert bench.heard == [[], [(took, 0x555)]]
    assert bench.drives == [(took, 0x555)]


def test_of_two_that_are_ready_the_lower_identifier_wins_and_the_other_waits() -> None:
    bench = Bench(3)
    rows = batch([LOW])
    bench.nodes[0].send(rows, 1)
    bench.nodes[1].send(batch([MIDDLE]), 1)
    bench.port.take_in()
    bench.run()
    first, both = bits(MIDDLE), bits(MIDDLE, LOW)
    assert bench.heard[2] == [(first, 0x155), (both, 0x2AA)]
    assert bench.heard[0] == [(first, 0x155)]
    assert bench.heard[1] == [(both, 0x2AA)]
    assert bench.port.statistics.latency_us == {"0x155": first, "0x2aa": both}


def test_what_comes_while_the_bus_is_busy_waits_even_with_the_highest_priority() -> None:
    bench = Bench(3)
    bench.send(0, LOW)
    bench.run(30)
    bench.send(1, HIGH)
    bench.run()
    assert bench.heard[2] == [(bits(LOW), 0x2AA), (bits(LOW, HIGH), 0x0AA)]
    found = bench.port.statistics.latency_us
    assert found["0x0aa"] == pytest.approx(bits(LOW, HIGH) - 30)
    assert found["0x2aa"] == bits(LOW)


def test_a_node_s_own_frames_do_not_overtake_each_other() -> None:
    bench = Bench(3)
    bench.send(0, LOW, HIGH)
    bench.send(1, MIDDLE)
    bench.run()
    assert [can_id for _, can_id in bench.heard[2]] == [0x155, 0x2AA, 0x0AA]


def test_the_wire_is_free_between_frames_that_come_apart() -> None:
    bench = Bench()
    bench.send(0, LOW)
    bench.run(1000)
    bench.send(0, HIGH)
    bench.run()
    assert bench.heard[1] == [(bits(LOW), 0x2AA), (1000 + bits(HIGH), 0x0AA)]
    assert bench.port.due == NEVER


def test_drives_answer_at_the_end_of_what_they_heard_and_contend_with_what_waits() -> None:
    bench = Bench()
    inbox = frame_buffer(4)
    bench.send(0, HIGH, LOW)  # LOW waits for HIGH, and is ready when that is through
    bench.now = bench.port.due
    assert bench.port.receive(inbox) == 0  # it begins
    bench.now = bench.port.due + 40 * US  # the process is late by 40 µs
    assert bench.port.receive(inbox) == 1
    assert bench.port.moment == bits(HIGH) * US
    bench.port.send(batch([pack(0x182, DATA), pack(0x181, DATA)]), 2, np.array([1, 0], np.int32))
    bench.run()
    one, two = pack(0x181, DATA), pack(0x182, DATA)
    assert bench.heard[0] == [
        (bits(HIGH, one), 0x181), (bits(HIGH, one, two), 0x182)
    ]  # fmt: skip
    assert bench.drives[-1] == (bits(HIGH, one, two, LOW), 0x2AA)
    done = bench.port.statistics
    assert done.late_max_us == 40.0
    assert done.late_mean_us == 10.0  # one of four
    assert done.exact_bits == bits(HIGH, LOW, one, two)


def test_half_the_bit_rate_takes_twice_as_long() -> None:
    bench = Bench(bitrate=500_000)
    bench.send(0, LOW)
    bench.run()
    assert bench.heard[1] == [(2 * bits(LOW), 0x2AA)]


def test_fd_frames_take_bits_of_both_rates_and_classical_ones_of_one() -> None:
    bench = Bench(data=5_000_000)
    fast, classical = pack_fd(0x123, bytes(range(64))), pack(0x124, DATA)
    bench.send(0, fast, classical)
    bench.run()
    slow_bits, fast_bits = exact_fd_bits(batch([fast], 72), 0)
    took = slow_bits + fast_bits / 5
    assert bench.heard[1] == [(int(took), 0x123), (int(took + bits(classical)), 0x124)]
    done = bench.port.statistics
    assert done.latency_us["0x123"] == pytest.approx(took, abs=0.1)
    assert (done.exact_bits, done.exact_data_bits) == (slow_bits + bits(classical), fast_bits)


def test_a_node_that_babbles_with_the_lowest_identifier_delays_the_others() -> None:
    # Every 250 µs a frame of its own; what is ready meanwhile waits for its end.
    babble = pack(0x000, b"\xaa" * 8)
    bench = Bench(2, kinds.BabbleFault(bus="can0", can_id=0x000, rate_hz=4000.0, data_bytes=8))
    own = bits(babble)
    bench.run(250)
    bench.send(0, LOW)
    bench.run(1100)
    assert bench.heard[1] == [
        (250 + own, 0x000), (250 + own + bits(LOW), 0x2AA), (500 + own, 0x000), (750 + own, 0x000)
    ]  # fmt: skip
    assert bench.port.statistics.latency_us["0x2aa"] == pytest.approx(own + bits(LOW))


def test_a_node_that_babbles_without_a_break_starves_the_others() -> None:
    fault = kinds.BabbleFault(bus="can0", can_id=0x000, rate_hz=20_000.0, data_bytes=8, end_s=5e-3)
    bench = Bench(2, fault)
    bench.run(60)
    bench.send(0, LOW)
    bench.run(6000)
    own = bits(pack(0x000, b"\xaa" * 8))
    starts = [at - own for at, can_id in bench.heard[1] if can_id == 0x000]
    assert starts == list(range(50, starts[-1] + 1, own))  # back to back, from the first on
    last = starts[-1] + own
    assert 5000 <= last < 5000 + 2 * own  # what it had when it ended is the last
    assert bench.heard[1][-1] == (last + bits(LOW), 0x2AA)


def test_a_babbling_node_of_low_priority_costs_others_one_frame_at_most() -> None:
    fault = kinds.BabbleFault(bus="can0", can_id=0x7FF, rate_hz=20_000.0, data_bytes=8)
    bench = Bench(2, fault)
    own = bits(pack(0x7FF, b"\xaa" * 8))
    for at in range(1000, 20_000, 777):
        bench.run(at)
        bench.send(0, LOW)
    bench.run(21_000)
    assert bits(LOW) < bench.port.statistics.latency_us["0x2aa"] <= own + bits(LOW)


def test_a_corrupted_frame_takes_its_time_and_contends_again() -> None:
    fault = kinds.FrameCorruptionFault(bus="can0", probability=0.99, can_id=0x155, end_s=1.0)
    bench = Bench(3, fault)
    bench.send(0, MIDDLE)
    bench.send(1, LOW)
    spoilt = bits(MIDDLE) + ERROR_BITS
    bench.run(spoilt + 1)
    assert bench.port.statistics.errors == 2  # the second attempt has begun
    assert bench.heard == [[], [], []]
    bench.send(2, HIGH)
    third = 2 * spoilt + bits(HIGH)  # when the third begins: HIGH has won against it
    bench.run(third)
    bench.port.advance(1.0)  # no more errors
    bench.run()
    through = third + spoilt + bits(MIDDLE)
    assert bench.drives == [(third, 0x0AA), (through, 0x155), (through + bits(LOW), 0x2AA)]
    done = bench.port.statistics
    assert done.errors == 3
    assert done.exact_bits == 3 * spoilt + bits(HIGH, MIDDLE, LOW)
    assert done.latency_us["0x155"] == through


def test_a_frame_that_nobody_takes_still_takes_its_time() -> None:
    bench = Bench(2, kinds.FrameLossFault(bus="can0", probability=1.0, can_id=0x155))
    bench.send(0, MIDDLE, LOW)
    bench.run()
    assert bench.heard[1] == [(bits(MIDDLE, LOW), 0x2AA)]
    assert bench.port.statistics.lost == 1


def test_a_duplicated_frame_comes_twice_in_a_row() -> None:
    bench = Bench(2, kinds.FrameDuplicationFault(bus="can0", probability=1.0, can_id=0x155))
    bench.send(0, MIDDLE, LOW)
    bench.run()
    assert bench.heard[1] == [
        (bits(MIDDLE), 0x155), (2 * bits(MIDDLE), 0x155), (2 * bits(MIDDLE) + bits(LOW), 0x2AA)
    ]  # fmt: skip


def test_a_late_frame_is_overtaken_by_those_behind_it() -> None:
    bench = Bench(2, kinds.FrameDelayFault(bus="can0", delay_s=1e-3, can_id=0x155))
    bench.send(0, MIDDLE, LOW)
    bench.run()
    assert bench.heard[1] == [(bits(LOW), 0x2AA), (1000 + bits(MIDDLE), 0x155)]


def test_a_controller_off_the_bus_takes_no_time_on_it() -> None:
    bench = Bench(2, kinds.BusOffFault(bus="can0", end_s=1.0))
    bench.send(0, LOW)
    bench.port.send(batch([pack(0x181, DATA)]), 1, np.zeros(1, np.int32))
    bench.run()
    told = (0, 0x2000_0040)  # an error frame of each interface, which is on no wire
    assert bench.heard == [[told], [told]]
    assert bench.drives == []
    assert bench.port.statistics.lost == 1
    assert bench.port.statistics.exact_bits == bits(pack(0x181, DATA))


def test_a_client_that_floods_the_bus_is_left_to_its_own_socket() -> None:
    bench = Bench(2)
    version = bench.port.fds_version
    rows = batch([LOW] * MOST_WAITING)
    bench.nodes[0].send(rows, MOST_WAITING)
    bench.port.take_in()
    assert bench.port.fds_version > version  # no longer waited on
    bench.nodes[0].send(rows, MOST_WAITING)
    bench.port.take_in()
    bench.nodes[1].send(batch([HIGH]), 1)
    bench.port.take_in()  # the others are read all the same
    bench.run(MOST_WAITING // 2 * bits(LOW))
    assert len(bench.heard[0]) == 1
    bench.run()
    assert len(bench.heard[1]) == MOST_WAITING
    bench.port.take_in()
    bench.run()
    assert len(bench.heard[1]) == 2 * MOST_WAITING
    assert bench.port.statistics.dropped == 0


def test_what_a_node_has_sent_before_it_left_comes_still() -> None:
    bench = Bench(3)
    bench.send(0, LOW, LOW)
    bench.nodes[0].close()
    bench.port.take_in()
    del bench.nodes[0], bench.heard[0]
    bench.run()
    assert len(bench.drives) == len(bench.heard[0]) == 2
    assert bench.port.statistics.departed == 1


def test_filters_hold_on_a_paced_bus() -> None:
    bench = Bench(3)
    bench.nodes[1].set_filters([(0x2AA, 0x7FF)])
    bench.send(0, HIGH, LOW)
    bench.run()
    assert bench.heard[1] == [(bits(HIGH, LOW), 0x2AA)]
    assert len(bench.heard[2]) == 2


def test_faults_without_time_are_refused() -> None:
    with pytest.raises(TypeError, match="paced"):
        PacedBus("can0").impair(Impairments("can0", [], 1, 0, lambda *_: None))
    with pytest.raises(InputError, match=r"bus\.timing: 'pace'.*lock-step"):
        unpaced("pace")
