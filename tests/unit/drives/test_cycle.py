import numpy as np
import pytest

from dftc_rt.bus.frame import frame_buffer, unpack
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.cia402.client import Cia402Client
from dftc_rt.drives.cia402.cycle import Cia402Cycle, steer
from dftc_rt.drives.interface import (
    GOAL_OFF,
    GOAL_OPERATE,
    GOAL_READY,
    GOAL_STOP,
    DriveConfig,
    SetUp,
    profile,
)
from dftc_rt.errors import InputError
from hil.drive import slots
from tests.unit.drives.drive_bus import DriveBus, configs, drives_of, scales


class Loop:
    """Controller's cycle and emulated drives, one step a millisecond."""

    def __init__(self, n: int = 4) -> None:
        self.drives = drives_of(scales(n))
        self.buses = [DriveBus(self.drives, bus) for bus in range((n - 1) // 3 + 1)]
        self.cycle = Cia402Cycle(configs(scales(n)), len(self.buses), 1000.0)
        self.cycle.start(Cia402Client(self.buses, configs(scales(n)), 1000.0).configure())
        self.k = 0
        self._out, self._in = frame_buffer(64), frame_buffer(64)
        self.seen: list[list[tuple[int, bytes]]] = []

    def step(self, tau: list[float]) -> None:
        cycle, out = self.cycle, self._out
        self.drives.tick(self.k * 1e-3)
        self.k += 1
        cycle.begin()
        for b, bus in enumerate(self.buses):
            bus.send(out, cycle.sync(b, out))
            count = bus.receive(self._in)
            self.seen.append([unpack(self._in[row]) for row in range(count)])
            cycle.decode(b, self._in, count)
        cycle.command(np.array(tau))
        for b, bus in enumerate(self.buses):
            bus.send(out, cycle.encode(b, out))


def test_torque_arrives_one_cycle_later_with_the_first_enable() -> None:
    loop = Loop()
    loop.cycle.goal = GOAL_OPERATE
    loop.step([1.0, -2.0, 3.0, -4.0])
    assert not loop.drives.command.any()  # held until the next SYNC
    assert not loop.drives.operation_enabled.any()
    loop.step([5.0, 5.0, 5.0, 5.0])
    # 1 Nm of 50 Nm is 20 per mille; the brake opens with that torque, not with zero.
    assert loop.drives.operation_enabled.tolist() == [1, 1, 1, 1]
    assert loop.drives.command.tolist() == [20, -40, 60, -80]
    assert loop.cycle.sent.tolist() == [5.0] * 4


def test_feedback_is_this_cycles() -> None:
    loop = Loop()
    loop.drives.objects[:, slots.POSITION] = [25_000, 0, 0, -25_000]
    loop.step([0.0] * 4)
    assert [loop.cycle.missing(b) for b in (0, 1)] == [0, 0]
    assert loop.cycle.q == pytest.approx([np.pi / 2, 0, 0, -np.pi / 2])
    loop.buses[1].deaf = True
    loop.step([0.0] * 4)
    assert [loop.cycle.missing(b) for b in (0, 1)] == [0, 1]
    assert (loop.cycle.seen & 1).tolist() == [1, 1, 1, 0]


def test_status_follows_and_torque_actual_takes_turns() -> None:
    loop = Loop()
    loop.cycle.goal = GOAL_OPERATE
    loop.drives.objects[:, slots.TORQUE_ACTUAL] = [100, 200, 300, 400]
    for _ in range(40):
        loop.step([1.0] * 4)
    assert [states.state_of(word) for word in loop.cycle.status] == [4, 4, 4, 4]
    assert loop.cycle.torque_actual.tolist() == [5.0, 10.0, 15.0, 20.0]
    slow = [sum(0x380 < can_id < 0x400 for can_id, _ in seen) for seen in loop.seen]
    assert max(slow) == 1
    # Counters 10, 20, 30, 40 for the first of each bus; 11, 21, 31 and 12, 22, 32 after it.
    assert sum(slow) == 4 + 3 + 3 + 4


def test_steering() -> None:
    # Statuswords of: switched on, operation enabled, ready, disabled, fault, quick stop.
    status = np.array([0x0233, 0x0237, 0x0231, 0x0250, 0x0218, 0x0217])
    word = np.zeros(6, dtype=np.int64)
    steer(GOAL_OPERATE, status, word)
    assert word.tolist() == [0x0F, 0x0F, 0x06, 0x06, 0x06, 0x06]
    for goal, expected in ((GOAL_READY, 0x07), (GOAL_STOP, 0x02), (GOAL_OFF, 0x00)):
        steer(goal, status, word)
        assert word.tolist() == [expected] * 6


def test_dropped_drive_is_not_switched_on_again() -> None:
    loop = Loop()
    loop.cycle.goal = GOAL_OPERATE
    for _ in range(20):
        loop.step([1.0] * 4)
    loop.drives.fault(1, 0x2310)
    for _ in range(40):
        loop.step([1.0] * 4)
    assert loop.drives.state.tolist() == [4, states.FAULT, 4, 4]
    assert loop.cycle.emergency.tolist() == [0, 0x2310, 0, 0]
    assert loop.cycle.emergencies.tolist() == [0, 1, 0, 0]


def test_quick_stop_ends_switched_off() -> None:
    loop = Loop()
    loop.cycle.goal = GOAL_OPERATE
    for _ in range(20):
        loop.step([1.0] * 4)
    loop.drives.objects[:, slots.VELOCITY] = 100_000
    loop.cycle.goal = GOAL_STOP
    for _ in range(20):
        loop.step([1.0] * 4)
    assert loop.drives.state.tolist() == [states.QUICK_STOP_ACTIVE] * 4
    assert not loop.drives.command.any()
    loop.drives.objects[:, slots.VELOCITY] = 0
    for _ in range(20):
        loop.step([1.0] * 4)
    assert [states.state_of(word) for word in loop.cycle.status] == [1, 1, 1, 1]


def test_heartbeats_keep_the_drives_going_and_silence_stops_them() -> None:
    loop = Loop()
    loop.cycle.goal = GOAL_OPERATE
    for _ in range(1000):
        loop.step([1.0] * 4)
    assert loop.drives.state.tolist() == [4] * 4
    sent = [can_id for can_id, _ in loop.buses[0].sent]
    assert sent.count(0x77F) == 20
    assert loop.cycle.heartbeats.tolist() == [9, 9, 9, 9]  # every 100 ms, staggered
    for k in range(1000, 1160):
        loop.drives.tick(k * 1e-3)
    assert loop.drives.state.tolist() == [states.FAULT] * 4
    assert not loop.drives.command.any()


def test_sync_counter_runs_from_1_to_240() -> None:
    cycle = Cia402Cycle(configs(scales(1)), 1, 1000.0)
    cycle.start(SetUp(np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)))
    counters = []
    for _ in range(482):
        cycle.begin()
        counters.append(cycle.counter)
    assert counters == [*range(1, 241), *range(1, 241), 1, 2]


def test_registry() -> None:
    assert profile("cia402").cycle is Cia402Cycle
    with pytest.raises(
        InputError, match=r"^bus\.profile: 'profibus' \(expected cia402 or mit or moteus\)"
    ):
        profile("profibus")


def test_same_node_id_on_one_bus() -> None:
    sheet = scales(1)[0]
    with pytest.raises(InputError, match="all different"):
        Cia402Cycle([DriveConfig(1, 0, sheet), DriveConfig(1, 0, sheet)], 1, 1000.0)
