"""CAN FD frames that take longest and shortest, and what a bus counts when it carries them."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from dftc_rt.bus.fd_bits import exact_fd_bits, nominal_fd_bits, worst_fd_bits
from dftc_rt.bus.frame import EFF_FLAG, FD_FRAME_SIZE, Frames, frame_buffer, pack_fd
from hil.bus.inprocess import InProcessPort
from tests.unit.bus.fd_stuffing import Extreme, extreme

RATIO = 5
LENGTHS = (0, 1, 8, 12, 16, 20, 24, 64)
# Slow and fast bits by which the longest frame is shorter than the bound. docs/bus.md says so.
SHORT_OF_WORST = {
    False: {0: (0, 2), 1: (0, 3), 8: (0, 2), 12: (0, 3), 16: (0, 3), 20: (0, 2), 24: (0, 2),
            64: (0, 2)},
    True: {0: (1, 1), 1: (1, 2), 8: (1, 1), 12: (1, 2), 16: (1, 2), 20: (1, 1), 24: (1, 1),
           64: (1, 1)},
}  # fmt: skip


def one(found: Extreme, extended: bool) -> Frames:
    frames = frame_buffer(1, FD_FRAME_SIZE)
    number = found.can_id | (EFF_FLAG if extended else 0)
    frames[0] = np.frombuffer(pack_fd(number, found.data), dtype=np.uint8)
    return frames


@pytest.mark.parametrize(("length", "extended"), list(product(LENGTHS, (False, True))))
def test_the_shortest_frame(length: int, extended: bool) -> None:
    found = extreme(length, extended=extended, most=False, ratio=RATIO)
    slow, fast = nominal_fd_bits(length, extended)
    assert exact_fd_bits(one(found, extended), 0) == (slow + found.slow, fast + found.fast)
    assert (found.slow, found.fast) == (0, 0)


@pytest.mark.parametrize(("length", "extended"), list(product(LENGTHS, (False, True))))
def test_the_longest_frame(length: int, extended: bool) -> None:
    found = extreme(length, extended=extended, most=True, ratio=RATIO)
    slow, fast = nominal_fd_bits(length, extended)
    exact = exact_fd_bits(one(found, extended), 0)
    assert exact == (slow + found.slow, fast + found.fast)
    bound = worst_fd_bits(length, extended)
    assert (bound[0] - exact[0], bound[1] - exact[1]) == SHORT_OF_WORST[extended][length]


@pytest.mark.parametrize("most", [False, True])
def test_the_bus_counts_them_to_the_bit(most: bool) -> None:
    """As long as moteus commands and answers, both ways over a bus."""
    port = InProcessPort("can0", data_bitrate=5_000_000)
    node = port.connect()
    inbox = frame_buffer(16, FD_FRAME_SIZE)
    slow = fast = 0
    for length, back in ((24, False), (12, False), (16, True), (20, True)):
        found = extreme(length, extended=True, most=most, ratio=RATIO)
        for _ in range(3):
            if back:
                port.send(one(found, True), 1)
            else:
                node.send(one(found, True), 1)
                assert port.receive(inbox) == 1
        least = nominal_fd_bits(length, True)
        slow += 3 * (least[0] + found.slow)
        fast += 3 * (least[1] + found.fast)
    counted = port.statistics
    assert (counted.exact_bits, counted.exact_data_bits) == (slow, fast)
    assert counted.nominal_bits <= slow <= counted.worst_bits
