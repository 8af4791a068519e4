"""The cycle of the MIT profile: what is sent when, and what is made of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.bus.frame import frame_buffer, unpack
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import (
    GOAL_OFF,
    GOAL_OPERATE,
    GOAL_READY,
    GOAL_STOP,
    DriveConfig,
    profile,
)
from dftc_rt.drives.mit import codec
from dftc_rt.drives.mit.client import MitClient
from dftc_rt.drives.mit.cycle import MitCycle, quantise, steer
from dftc_rt.drives.scale import ScaleTable
from dftc_rt.errors import InputError
from hil.drive import slots
from tests.unit.drives.drive_bus import DriveBus
from tests.unit.drives.mit.mit_bus import configs, drives_of, scales

HALF = 18.0 / 4095
ENTER = bytes.fromhex("fffffffffffffffc")
LEAVE = bytes.fromhex("fffffffffffffffd")


class Loop:
    """Controller's cycle and emulated drives, one step a millisecond."""

    def __init__(self, n: int = 4, **sheet: object) -> None:
        sheets = scales(n, **sheet)
        self.drives = drives_of(sheets)
        self.buses = [DriveBus(self.drives, bus) for bus in range((n - 1) // 3 + 1)]
        self.cycle = MitCycle(configs(sheets), len(self.buses), 1000.0)
        self.cycle.start(MitClient(self.buses, configs(sheets), 1000.0).configure())
        self.k = 0
        self._out, self._in = frame_buffer(64), frame_buffer(64)
        self.sent: list[dict[int, bytes]] = []  # of each step: node -> frame

    def step(self, tau: list[float]) -> None:
        cycle = self.cycle
        self.drives.tick(self.k * 1e-3)
        self.k += 1
        cycle.begin()
        self.sent.append({})
        for b, bus in enumerate(self.buses):
            rows = cycle.sync(b, self._out)
            self.sent[-1] |= dict(unpack(self._out[row]) for row in range(rows))
            bus.send(self._out, rows)
            cycle.decode(b, self._in, bus.receive(self._in))
        cycle.command(np.array(tau))
        assert all(cycle.encode(b, self._out) == 0 for b in range(len(self.buses)))


def test_torque_goes_out_at_the_next_tick() -> None:
    loop = Loop()
    loop.cycle.goal = GOAL_OPERATE
    loop.step([1.0] * 4)  # zero torque, to drives that are off
    assert set(loop.sent[0].values()) == {bytes.fromhex("7fff7ff0000007ff")}
    assert not loop.drives.operation_enabled.any()
    assert loop.cycle.sent.tolist() == [0.0] * 4  # not a torque, but ENTER is what goes out next
    loop.step([1.0] * 4)
    assert set(loop.sent[1].values()) == {ENTER}
    assert loop.drives.operation_enabled.all()
    assert not loop.drives.command.any()
    wanted = [1.0, -2.0, 3.0, -4.0]
    loop.step(wanted)
    sent = loop.cycle.sent.copy()
    loop.step([9.0] * 4)
    # 1 Nm is 227.5 half steps: of the odd ones 227 is the nearest; -2 Nm -455; 3 Nm 682.5:
    # 683; -4 Nm -910: of -909 and -911, equally near, the lower.
    assert loop.drives.command.tolist() == [227, -455, 683, -911]
    assert sent == pytest.approx(np.array([227, -455, 683, -911]) * HALF)
    assert np.abs(sent - wanted).max() <= HALF * (1 + 1e-9)
    assert sorted(loop.sent[3]) == [1, 2, 3, 4]


def test_feedback_is_this_cycles() -> None:
    loop = Loop()
    loop.drives.objects[:, slots.POSITION] = np.array([1, 0, 0, -2]) << 18  # quarter turns
    loop.drives.objects[:, slots.VELOCITY] = 1 << 20  # a turn a second
    loop.drives.objects[:, slots.TORQUE_ACTUAL] = 455
    loop.step([0.0] * 4)
    assert [loop.cycle.missing(b) for b in (0, 1)] == [0, 0]
    half = 0.5 * 25 / 65535 * (1 + 1e-9)
    assert np.abs(loop.cycle.q - [np.pi / 2, 0, 0, -np.pi]).max() <= half
    assert loop.cycle.v == pytest.approx([2 * np.pi] * 4, abs=0.5 * 90 / 4095)
    assert loop.cycle.torque_actual == pytest.approx([2.0] * 4, abs=HALF * 1.01)
    loop.buses[1].deaf = True
    loop.step([0.0] * 4)
    assert [loop.cycle.missing(b) for b in (0, 1)] == [0, 1]
    assert loop.cycle.seen.tolist() == [1, 1, 1, 0]


def test_steering() -> None:
    bits = states.STATE_BITS
    every = (states.SWITCHED_ON, states.OPERATION_ENABLED, states.SWITCH_ON_DISABLED, states.FAULT)
    status = bits[list(every)].copy()
    off, on, enabled = (int(bits[s]) for s in (states.SWITCH_ON_DISABLED, *every[:2]))
    asked, after = np.zeros(4, dtype=np.int64), np.zeros(4, dtype=np.int64)
    steer(GOAL_OPERATE, status, asked, after)
    assert asked.tolist() == [codec.ENTER, codec.TORQUE, codec.LEAVE, codec.LEAVE]
    assert after.tolist() == [enabled, enabled, off, off]
    steer(GOAL_READY, status, asked, after)
    assert after.tolist() == [on, on, off, off]
    for goal in (GOAL_STOP, GOAL_OFF):
        steer(goal, status, asked, after)
        assert asked.tolist() == [codec.LEAVE] * 4
        assert after.tolist() == [off] * 4


def test_stop_leaves_motor_mode_and_stays_out_of_it() -> None:
    loop = Loop()
    loop.cycle.goal = GOAL_OPERATE
    for _ in range(5):
        loop.step([1.0] * 4)
    assert loop.drives.operation_enabled.all()
    loop.cycle.goal = GOAL_STOP
    loop.step([1.0] * 4)  # the last torque is under way
    assert loop.drives.operation_enabled.all()
    assert not loop.cycle.sent.any()
    loop.step([1.0] * 4)
    assert set(loop.sent[-1].values()) == {LEAVE}
    assert not loop.drives.operation_enabled.any()
    assert not loop.drives.command.any()
    assert [states.state_of(s) for s in loop.cycle.status] == [states.OPERATION_ENABLED] * 4
    loop.step([1.0] * 4)  # answered for the second time
    assert [states.state_of(s) for s in loop.cycle.status] == [states.SWITCH_ON_DISABLED] * 4
    loop.cycle.goal = GOAL_OPERATE
    for _ in range(5):
        loop.step([1.0] * 4)
    assert not loop.drives.operation_enabled.any()


def test_enter_is_repeated_until_it_is_answered() -> None:
    loop = Loop(2)
    loop.cycle.goal = GOAL_OPERATE
    loop.step([1.0] * 2)
    loop.buses[0].deaf = True
    loop.step([1.0] * 2)
    loop.step([1.0] * 2)
    assert states.state_of(loop.cycle.status[0]) == states.SWITCHED_ON
    loop.buses[0].deaf = False
    loop.step([1.0] * 2)
    assert [set(sent.values()) for sent in loop.sent[1:]] == [{ENTER}] * 3
    assert [states.state_of(s) for s in loop.cycle.status] == [states.OPERATION_ENABLED] * 2


def test_an_error_is_a_fault_and_the_drive_is_not_switched_on_again() -> None:
    loop = Loop(answer_bytes=8)
    loop.cycle.goal = GOAL_OPERATE
    for _ in range(5):
        loop.step([1.0] * 4)
    assert loop.cycle.temperature.tolist() == [30] * 4
    loop.drives.fault(1, 7)
    loop.step([1.0] * 4)
    assert loop.cycle.error.tolist() == [0, 7, 0, 0]
    found = [states.state_of(s) for s in loop.cycle.status]
    assert found == [states.OPERATION_ENABLED, states.FAULT, *[states.OPERATION_ENABLED] * 2]
    loop.drives.fault(1, 0)
    for _ in range(5):
        loop.step([1.0] * 4)
    assert loop.drives.operation_enabled.tolist() == [1, 0, 1, 1]
    assert states.state_of(loop.cycle.status[1]) == states.SWITCH_ON_DISABLED


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=2, max_size=2))
def test_quantised_torque_is_limited_and_nearest(tau: list[float]) -> None:
    sheets = [*scales(1, max_torque_nm=10.0), *scales(1, sign=-1)]
    code, sent = np.zeros(2, dtype=np.int64), np.zeros(2)
    asked = np.full(2, codec.TORQUE)
    quantise(np.array(tau), ScaleTable.of(sheets).values, asked, code, sent)
    for i, limit in enumerate((2275 * HALF, 18.0)):
        wanted = 0.0 if math.isnan(tau[i]) else min(max(tau[i], -limit), limit)
        sign = sheets[i].sign
        assert sent[i] == pytest.approx(sign * (2 * code[i] - 4095) * HALF)
        assert abs(sent[i] - wanted) <= HALF * (1 + 1e-6)
        assert abs(sent[i]) <= limit * (1 + 1e-12)


def test_torque_at_the_limit_is_sent_as_the_limit() -> None:
    sheets = scales(1, max_torque_nm=10.0)
    code, sent = np.zeros(1, dtype=np.int64), np.zeros(1)
    asked = np.full(1, codec.TORQUE)
    table = ScaleTable.of(sheets).values
    for sign in (1, -1):
        quantise(np.array([sign * 1e3]), table, asked, code, sent)
        assert sent[0] == sign * 2275 * table[2, 0]  # exactly: the supervisor compares


def test_registry() -> None:
    assert profile("mit").cycle is MitCycle


def test_same_node_id_on_one_bus() -> None:
    sheet = scales(1)[0]
    with pytest.raises(InputError, match="all different"):
        MitCycle([DriveConfig(1, 0, sheet), DriveConfig(1, 0, sheet)], 1, 1000.0)
