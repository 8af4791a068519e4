"""Both ends of the MIT profile against an implementation of the packing of its own.

What is below "independent" knows the publication and nothing of the project: ranges, widths,
order of the fields; integers and struct. The emulated drives are driven with frames that it
packs, and their answers, like the controller's commands, are read by it.
"""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from dftc_rt.bus.frame import frame_buffer, unpack
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import GOAL_OPERATE, SetUp
from dftc_rt.drives.mit.cycle import MitCycle
from hil.drive import slots
from tests.unit.drives.drive_bus import DriveBus
from tests.unit.drives.mit.mit_bus import configs, drives_of, scales

# --- independent -----------------------------------------------------------------------

P, V, KP, KD, T = 12.5, 45.0, 500.0, 5.0, 18.0


def command(p: float, v: float, kp: float, kd: float, t: float) -> bytes:
    """Return the eight bytes of a command."""
    word = 0
    for x, low, high, bits in (
        (p, -P, P, 16), (v, -V, V, 12), (kp, 0.0, KP, 12), (kd, 0.0, KD, 12), (t, -T, T, 12),
    ):  # fmt: skip
        word = word << bits | math.floor((x - low) / (high - low) * (2**bits - 1))
    return struct.pack(">Q", word)


def torque_of(data: bytes) -> float:
    """Return the torque of a command whose gains are zero."""
    (word,) = struct.unpack(">Q", data)
    assert word >> 12 & 0xFFFFFF == 0, "gains"
    return (word & 0xFFF) / 4095 * 2 * T - T


def state_of(data: bytes) -> tuple[int, float, float, float]:
    """Return node, position, velocity and torque of an answer."""
    node, p, rest = struct.unpack(">BH3s", data[:6])
    v, t = divmod(int.from_bytes(rest, "big"), 1 << 12)
    return node, p / 65535 * 2 * P - P, v / 4095 * 2 * V - V, t / 4095 * 2 * T - T


ENTER = struct.pack(">Q", 0xFFFF_FFFF_FFFF_FFFC)
STEPS = (2 * P / 65535, 2 * V / 4095, 2 * T / 4095)

# --- the rig's end ---------------------------------------------------------------------


@pytest.fixture(params=[6, 8])
def bus(request: pytest.FixtureRequest) -> DriveBus:
    return DriveBus(drives_of(scales(3, answer_bytes=request.param)))


def test_answers(bus: DriveBus) -> None:
    random = np.random.default_rng(5)
    counts_per_rad = (1 << 20) / math.tau
    for _ in range(300):
        q = random.uniform(-12.0, 12.0, 3)
        v, t = random.uniform(-44.0, 44.0, 3), random.uniform(-17.9, 17.9, 3)
        bus.drives.objects[:, slots.POSITION] = np.rint(q * counts_per_rad)
        bus.drives.objects[:, slots.VELOCITY] = np.rint(v * counts_per_rad)
        bus.drives.objects[:, slots.TORQUE_ACTUAL] = np.rint(t / T * 4095)
        found = bus.exchange(*((node, command(0, 0, 0, 0, 0)) for node in (1, 2, 3)))
        assert [can_id for can_id, _ in found] == [0, 0, 0]
        for i, (_, data) in enumerate(found):
            node, *told = state_of(data)
            assert node == i + 1
            for is_, said, step in zip((q[i], v[i], t[i]), told, STEPS, strict=True):
                # cut off: at most a step less; and rounding of encoder and current
                assert -0.51 * T / 4095 < is_ - said < step * 1.01 + 0.51 * T / 4095


def test_commands_are_followed(bus: DriveBus) -> None:
    bus.exchange(*((node, ENTER) for node in (1, 2, 3)))
    assert bus.drives.operation_enabled.all()
    random = np.random.default_rng(6)
    for _ in range(300):
        wanted = random.uniform(-T, T, 3)
        frames = [command(0, 0, 0, 0, t) for t in wanted]
        bus.exchange(*((node + 1, data) for node, data in enumerate(frames)))
        followed = bus.drives.command * T / 4095
        assert followed == pytest.approx([torque_of(data) for data in frames], abs=1e-9)
        assert np.all(np.abs(followed - wanted) < STEPS[2])


# --- the controller's end --------------------------------------------------------------


def test_what_the_controller_sends_is_what_it_says_it_sends() -> None:
    cycle = MitCycle(configs(scales(3)), 1, 1000.0)
    enabled = np.full(3, states.STATE_BITS[states.OPERATION_ENABLED])
    cycle.start(SetUp(enabled, np.full(3, 32767)))
    cycle.goal = GOAL_OPERATE
    out = frame_buffer(3)
    random = np.random.default_rng(7)
    for wanted in random.uniform(-1.1 * T, 1.1 * T, (300, 3)):
        cycle.command(wanted)
        assert cycle.sync(0, out) == 3
        sent = [unpack(out[row]) for row in range(3)]
        assert [can_id for can_id, _ in sent] == [1, 2, 3]
        assert [torque_of(data) for _, data in sent] == pytest.approx(cycle.sent, abs=1e-12)
        limited = np.clip(wanted, -T, T)
        assert np.all(np.abs(cycle.sent - limited) <= 0.5 * STEPS[2] * (1 + 1e-9))
