"""Latency where each drive answers its own command: sums by hand, and buses played through."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from dftc_rt.bus.budget import bus_load
from dftc_rt.bus.frame import EFF_FLAG, frame_buffer, pack
from dftc_rt.bus.polled_latency import (
    Polled,
    arbitration,
    mit_frames,
    moteus_frames,
    polled_latencies,
)
from hil.bus.arbitration import order_by_identifier


def ends(drives: list[Polled], command: float = 10, answer: float = 1) -> list[tuple[str, float]]:
    """Who is through when, as letter and node (its place), in order of the wire."""
    found = polled_latencies(drives, command, answer, 1000)
    return [(each.stream.name, float(each.bits or 0)) for each in found]


def test_answers_before_commands() -> None:
    """Identifier 0: each answer goes before the next command, 10 and 1 bits long."""
    assert ends(mit_frames([1, 2, 3], 0)) == [
        ("command", 10), ("answer", 11), ("command", 21), ("answer", 22), ("command", 32),
        ("answer", 33),
    ]  # fmt: skip


def test_commands_before_answers() -> None:
    """moteus up to node 7: 8001h has eleven zeros, 100h has not."""
    assert ends(moteus_frames([1, 2, 7], 0)) == [
        ("command", 10), ("command", 20), ("command", 30), ("answer", 31), ("answer", 32),
        ("answer", 33),
    ]  # fmt: skip


def test_answers_with_29_bits_are_before_commands_again() -> None:
    """900h has eleven zeros too, and is less than 8000h in the 18 bits behind them."""
    assert ends(moteus_frames([9, 1, 10], 0)) == [
        ("command", 10),  # 8001h
        ("command", 20),  # 8009h; the answer 100h waits
        ("answer", 21),  # 900h
        ("command", 31),  # 800Ah
        ("answer", 32),  # A00h
        ("answer", 33),  # 100h
    ]


def test_a_full_bus_has_no_bound() -> None:
    found = polled_latencies(mit_frames([1, 2], 0), 300, 200, 999)
    assert [each.bits for each in found] == [None] * 4
    found = polled_latencies(mit_frames([1, 2], 0), 300, 200, 1000)
    assert found[-1].bits == 1000


@pytest.mark.parametrize("seed", range(5))
def test_arbitration_is_that_of_the_virtual_bus(seed: int) -> None:
    rng = np.random.default_rng(seed)
    short = rng.integers(0, 0x800, 100)
    long = rng.integers(0, 1 << 29, 100)
    near = (short[:50].astype(np.int64) << 18) | rng.integers(0, 4, 50)  # the same 11 bits
    ids = [*short.tolist(), *((np.concatenate([long, near])) | EFF_FLAG).tolist()]
    frames = frame_buffer(len(ids))
    for row, number in enumerate(ids):
        frames[row] = np.frombuffer(pack(number, b""), dtype=np.uint8)
    order = np.zeros(len(ids), dtype=np.int64)
    order_by_identifier(frames, len(ids), order)
    assert [ids[k] for k in order] == sorted(ids, key=arbitration)


@pytest.mark.parametrize("profile", ["mit", "moteus"])
@pytest.mark.parametrize("joints", [1, 3, 4])
def test_no_frame_is_later_when_frames_are_shorter(profile: str, joints: int) -> None:
    """A bus played through with frames of random lengths up to the longest."""
    load = bus_load("can0", joints, rate_hz=400.0, profile=profile)
    command, answer = (item.frame_worst_bits for item in load.items)
    nodes = list(range(1, joints + 1))
    drives = mit_frames(nodes, 0) if profile == "mit" else moteus_frames(nodes, 0)
    bounds = polled_latencies(drives, command, answer, 2500)
    total = Fraction(joints) * (Fraction(command) + Fraction(answer))
    assert bounds[-1].bits == total
    rng = np.random.default_rng(joints)
    for _ in range(50):
        at = 0.0
        ready = [(arbitration(each.command), k, True) for k, each in enumerate(drives)]
        for bound in bounds:
            head = min(ready)
            ready.remove(head)
            at += rng.uniform(0.7, 1.0) * (command if head[2] else answer)
            if head[2]:
                ready.append((arbitration(drives[head[1]].answer), head[1], False))
            assert bound.bits is not None
            assert (bound.stream.name == "command") == head[2]
            assert at <= bound.bits
