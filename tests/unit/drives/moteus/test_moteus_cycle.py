"""The cycle of the moteus profile: what is sent when, and what is made of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.bus.frame import FD_FRAME_SIZE, frame_buffer, pack_fd, unpack
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import (
    GOAL_OFF,
    GOAL_OPERATE,
    GOAL_READY,
    GOAL_STOP,
    DriveConfig,
    profile,
)
from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus.client import MoteusClient
from dftc_rt.drives.moteus.cycle import MoteusCycle, steer
from dftc_rt.errors import InputError
from hil.drive import slots
from tests.unit.drives.moteus.moteus_bus import bus_of, configs, drives_of, scales

QUERY = bytes.fromhex("11001d011602110f")
STOP = bytes.fromhex("01000011001d011602110f50")
RUNNING = states.OPERATION_ENABLED


def torque(hundredths: int, timeout: int = 0) -> bytes:
    """Return the torque command: NaN, 0, the torque, scales 0, time-out, questions."""
    low, high = hundredths & 0xFF, hundredths >> 8 & 0xFF
    return bytes.fromhex(
        f"01000a 02208000 0522{low:02x}{high:02x} 02230000 0127{timeout:02x} 11001d011602"
    )


class Loop:
    """Controller's cycle and emulated drives, one step a millisecond."""

    def __init__(self, n: int = 5, **sheet: object) -> None:
        sheets = scales(n, **sheet)
        self.drives = drives_of(sheets, watchdog_s=0.005)
        self.buses = [bus_of(self.drives, bus) for bus in range((n - 1) // 4 + 1)]
        self.cycle = MoteusCycle(configs(sheets), len(self.buses), 1000.0)
        self.cycle.start(MoteusClient(self.buses, configs(sheets), 1000.0).configure())
        self.k = 0
        self._out, self._in = (frame_buffer(64, FD_FRAME_SIZE) for _ in range(2))
        self.sent: list[dict[int, bytes]] = []  # of each step: node -> frame

    def step(self, tau: list[float]) -> None:
        cycle = self.cycle
        self.drives.tick(self.k * 1e-3)
        self.k += 1
        cycle.begin()
        self.sent.append({})
        for b, bus in enumerate(self.buses):
            rows = cycle.sync(b, self._out)
            frames = [unpack(self._out[row]) for row in range(rows)]
            self.sent[-1] |= {can_id & 0x7F: data for can_id, data in frames}
            bus.send(self._out, rows)
            cycle.decode(b, self._in, bus.receive(self._in))
        cycle.command(np.array(tau))
        assert all(cycle.encode(b, self._out) == 0 for b in range(len(self.buses)))

    def run(self, steps: int = 5) -> None:
        """Run with 1 Nm."""
        self.cycle.goal = GOAL_OPERATE
        for _ in range(steps):
            self.step([1.0] * len(self.cycle.q))

    def states(self) -> list[int]:
        return [int(states.state_of(word)) for word in self.cycle.status]


def test_torque_goes_out_at_the_next_tick() -> None:
    loop = Loop()
    loop.cycle.goal = GOAL_OPERATE
    loop.step([1.0] * 5)  # at first they are asked only
    assert set(loop.sent[0].values()) == {QUERY}
    assert not loop.drives.operation_enabled.any()
    assert loop.cycle.sent.tolist() == [0.0] * 5  # position mode first, and no torque with it
    wanted = [1.0, -2.0, 3.004, -4.006, 0.0]
    loop.step(wanted)
    assert set(loop.sent[1].values()) == {torque(0)}
    assert loop.drives.operation_enabled.all()
    assert not loop.drives.command.any()
    assert loop.cycle.sent == pytest.approx([1.0, -2.0, 3.0, -4.01, 0.0])
    loop.step([9.0] * 5)
    assert loop.sent[2] == {
        node: torque(counts) for node, counts in enumerate([100, -200, 300, -401, 0], start=1)
    }
    assert loop.drives.command.tolist() == [100, -200, 300, -401, 0]


def test_time_out_is_in_every_command() -> None:
    loop = Loop(1, timeout=7)
    loop.run()
    assert loop.sent[-1] == {1: torque(100, 7)}
    assert loop.drives.objects[0, slots.WATCHDOG] == 70_000


def test_feedback_is_this_cycles() -> None:
    loop = Loop()
    loop.drives.objects[:, slots.POSITION] = np.array([1, 0, 0, -2, 3]) << 18  # quarter turns
    loop.drives.objects[:, slots.VELOCITY] = 1 << 20  # a turn a second
    loop.drives.objects[:, slots.TORQUE_ACTUAL] = 200
    loop.step([0.0] * 5)
    assert [loop.cycle.missing(b) for b in (0, 1)] == [0, 0]
    assert loop.cycle.q == pytest.approx(np.array([1, 0, 0, -2, 3]) * np.pi / 2)
    assert loop.cycle.v == pytest.approx([2 * np.pi] * 5)
    assert loop.cycle.torque_actual == pytest.approx([2.0] * 5)
    loop.buses[1].deaf = True
    loop.step([0.0] * 5)
    assert [loop.cycle.missing(b) for b in (0, 1)] == [0, 1]
    assert loop.cycle.seen.tolist() == [1, 1, 1, 1, 0]


def test_steering() -> None:
    bits = states.STATE_BITS
    every = (states.SWITCHED_ON, RUNNING, states.SWITCH_ON_DISABLED, states.FAULT)
    status = bits[list(every)].copy()
    off, on = int(bits[states.SWITCH_ON_DISABLED]), int(bits[states.SWITCHED_ON])
    asked, after = np.zeros(4, dtype=np.int64), np.zeros(4, dtype=np.int64)
    steer(GOAL_OPERATE, status, asked, after)
    assert asked.tolist() == [codec.TORQUE, codec.TORQUE, codec.STOP, codec.QUERY]
    assert after.tolist() == [on, off, off, off]
    steer(GOAL_READY, status, asked, after)
    assert asked.tolist() == [codec.STOP, codec.STOP, codec.STOP, codec.QUERY]
    assert after.tolist() == [on, on, off, off]
    for goal in (GOAL_STOP, GOAL_OFF):
        steer(goal, status, asked, after)
        assert asked.tolist() == [codec.STOP] * 4
        assert after.tolist() == [off] * 4


def test_ready_is_stopped_and_can_operate_again() -> None:
    loop = Loop()
    loop.run()
    loop.cycle.goal = GOAL_READY
    for _ in range(3):
        loop.step([1.0] * 5)
    assert set(loop.sent[-1].values()) == {STOP}
    assert loop.states() == [states.SWITCHED_ON] * 5
    loop.run(3)
    assert loop.states() == [RUNNING] * 5


def test_stop_takes_torque_off_and_leaves_it_off() -> None:
    loop = Loop()
    loop.run()
    assert loop.states() == [RUNNING] * 5
    loop.cycle.goal = GOAL_STOP
    loop.step([1.0] * 5)  # the last torque is under way
    assert loop.drives.operation_enabled.all()
    assert not loop.cycle.sent.any()
    loop.step([1.0] * 5)
    assert set(loop.sent[-1].values()) == {STOP}
    assert not loop.drives.operation_enabled.any()
    assert loop.states() == [states.SWITCH_ON_DISABLED] * 5
    loop.run()
    assert not loop.drives.operation_enabled.any()


def test_position_mode_is_commanded_until_it_is_answered() -> None:
    loop = Loop(2)
    loop.cycle.goal = GOAL_OPERATE
    loop.step([1.0] * 2)
    loop.buses[0].deaf = True
    loop.step([1.0] * 2)
    loop.step([1.0] * 2)
    assert loop.states() == [states.SWITCHED_ON] * 2
    loop.buses[0].deaf = False
    loop.step([1.0] * 2)
    assert [set(sent.values()) for sent in loop.sent[1:]] == [{torque(0)}] * 3
    assert loop.states() == [RUNNING] * 2


def answer(cycle: MoteusCycle, mode: int) -> None:
    """Hand over an answer of the first drive in some mode."""
    batch = frame_buffer(1, FD_FRAME_SIZE)
    data = bytes.fromhex(f"2100{mode:02x} 2f01" + "00" * 12 + "505050")
    batch[0] = np.frombuffer(pack_fd(0x100, data), dtype=np.uint8)
    assert cycle.decode(0, batch, 1) == 0


def test_an_answer_from_before_the_change_of_mode_does_no_harm() -> None:
    cycle = Loop(1).cycle
    cycle.goal = GOAL_OPERATE
    cycle.command(np.ones(1))
    for mode in (0, 2, 4):  # stopped; preparing
        answer(cycle, mode)
        assert states.state_of(cycle.status[0]) == states.SWITCHED_ON
        cycle.command(np.ones(1))
        assert not cycle.sent.any()
    answer(cycle, 10)
    cycle.command(np.ones(1))
    assert states.state_of(cycle.status[0]) == RUNNING
    assert cycle.sent.tolist() == [1.0]
    answer(cycle, 0)  # somebody has stopped it
    cycle.command(np.ones(1))
    assert states.state_of(cycle.status[0]) == states.SWITCH_ON_DISABLED
    assert not cycle.sent.any()


def test_a_fault_is_seen_and_its_code_stays_until_the_run_stops() -> None:
    loop = Loop()
    loop.run()
    loop.drives.fault(1, 33)
    loop.step([1.0] * 5)
    assert loop.states() == [RUNNING, states.FAULT, *[RUNNING] * 3]
    assert loop.cycle.sent.tolist() == [1.0, 0.0, 1.0, 1.0, 1.0]
    loop.drives.fault(1, 0)
    loop.step([1.0] * 5)
    assert loop.sent[-1][2] == QUERY
    assert loop.cycle.fault.tolist() == [0, 33, 0, 0, 0]
    assert loop.drives.operation_enabled.tolist() == [1, 0, 1, 1, 1]
    loop.cycle.goal = GOAL_STOP
    for _ in range(2):
        loop.step([1.0] * 5)
    assert loop.states() == [states.SWITCH_ON_DISABLED] * 5


def test_a_watchdog_that_has_fired_is_a_fault() -> None:
    loop = Loop(2)
    loop.run()
    loop.k += 10
    loop.step([1.0] * 2)
    assert loop.states() == [states.FAULT] * 2
    assert loop.cycle.mode.tolist() == [11, 11]
    assert not loop.cycle.sent.any()


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=2, max_size=2))
def test_quantised_torque_is_limited_and_nearest(tau: list[float]) -> None:
    cycle = CYCLE
    cycle.goal = GOAL_OPERATE
    cycle.status[:] = states.STATE_BITS[RUNNING]
    cycle.command(np.array(tau))
    for i, limit in enumerate((10.0, 18.0)):
        wanted = 0.0 if math.isnan(tau[i]) else min(max(tau[i], -limit), limit)
        assert abs(cycle.sent[i] - wanted) <= 0.005 * (1 + 1e-6)
        assert cycle.sent[i] == pytest.approx((1, -1)[i] * 0.01 * cycle.counts[i])
        assert abs(cycle.sent[i]) <= limit * (1 + 1e-12)


CYCLE = MoteusCycle(
    [
        DriveConfig(1, 0, scales(1, max_torque_nm=10.0)[0]),
        DriveConfig(2, 0, scales(1, sign=-1)[0]),
    ],
    1,
    1000.0,
)


def test_registry() -> None:
    found = profile("moteus")
    assert found.cycle is MoteusCycle
    assert (found.fd, profile("mit").fd) == (True, False)


def test_same_node_id_on_one_bus() -> None:
    sheet = scales(1)[0]
    with pytest.raises(InputError, match="all different"):
        MoteusCycle([DriveConfig(1, 0, sheet), DriveConfig(1, 0, sheet)], 1, 1000.0)
