"""What ``dftc rig`` says of its buses when it ends."""

from __future__ import annotations

from dftc_rt.cli.rig import traffic
from dftc_rt.config import faults as kinds
from hil.bus.impairments import Impairments
from hil.bus.inprocess import InProcessPort
from tests.conformance.bus_transports import batch


def test_load_latency_and_what_went_wrong() -> None:
    port = InProcessPort("can0")
    twice = [kinds.FrameDuplicationFault(bus="can0", probability=1.0)]
    port.impair(Impairments("can0", twice, 1, 0, lambda *_: None))
    port.advance(0.0)
    port.send(batch([(0x555, b"\x55" * 8), (0x080, b"")]), 2)
    done = port.statistics
    assert traffic("can0", done, 1e-3) == (
        f"can0: 4 frames, {done.exact_bits / 1000:.1%} of the time, "
        f"through within {done.exact_bits} µs (the slowest: 0x555), 2 duplicated"
    )


def test_a_bus_that_counts_no_bits_has_no_load() -> None:
    port = InProcessPort("can1", timing="off")
    port.send(batch([(0x080, b"")]), 1)
    assert traffic("can1", port.statistics, 1.0) == "can1: 1 frames"
