"""The rig with moteus drives: steps without SYNC, delays, watchdogs, time."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.config.scenario import (
    BusTable,
    DriveTable,
    RigTable,
    RobotTable,
    Scenario,
)
from dftc_rt.drives.interface import GOAL_OPERATE, GOAL_STOP, DriveSetup, SetUp, profile
from dftc_rt.drives.moteus.scale import scales_of
from dftc_rt.drives.wiring import frame_size, robot_drives
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.memory import MemorySink
from dftc_rt.rt.clock import FakeClock, LockstepClock
from dftc_rt.rt.drive_link import DriveLink
from dftc_rt.rt.outside import OutsideCycles
from hil.simulate import in_process_rig

F64 = NDArray[np.float64]
PERIOD_NS = 1_000_000
PERIOD_S = 1e-3
WATCHDOG_S = 0.010


class Bench:
    """A rig, and the controller's end of its two buses in the test's hands."""

    def __init__(self, wall: bool) -> None:
        self.robot = load_robot("ur5")
        n = self.robot.n
        bus = BusTable(profile="moteus")
        scenario = Scenario(
            name="bench",
            robot=RobotTable(name="ur5"),
            bus=bus,
            rig=RigTable(drive=DriveTable(watchdog_s=WATCHDOG_S, brake_close_s=0.0)),
        )
        self.sink = MemorySink(1 + 6 * n)
        self.wall = wall
        self.clock = FakeClock()
        motion = np.zeros((3, n))
        motion[0] = self.robot.home
        joined = in_process_rig(
            scenario, self.robot, motion, self.sink, lambda *e: None,
            self.clock.now if wall else None,
        )  # fmt: skip
        self.rig = joined.rig
        self.sockets = joined.sockets
        self.drives = robot_drives(self.robot, bus)
        self.link = DriveLink(
            self.sockets, profile("moteus").cycle(self.drives, len(self.sockets), 1000.0),
            self.clock if wall else LockstepClock(), 0.0, lambda source, text: None,
            frame_size(bus),
        )  # fmt: skip
        self.k = 0

    def configure(self) -> SetUp:
        return self.setup().configure()

    def setup(self) -> DriveSetup:
        setup = profile("moteus").setup(self.sockets, self.drives, 1000.0)
        return (
            setup
            if self.wall
            else OutsideCycles(setup, self.sockets, frame_size(BusTable(profile="moteus")))
        )

    def enable(self, tau: F64) -> None:
        """Set up, and run until the torque of a cycle has gone out to enabled drives."""
        self.link.start(self.configure())
        self.link.goal = GOAL_OPERATE
        for _ in range(5):
            self.exchange()
            self.link.command(tau)
        assert self.link.all_enabled()

    def exchange(self) -> None:
        """One tick on every bus, one period after the last."""
        self.clock.time += PERIOD_NS
        self.link.exchange(self.k, self.clock.time)
        self.k += 1

    def column(self, row: int) -> F64:
        """One row of /rig over time, (K, n): 0 q, 1 v, 2 tau_applied, 3 rho, 4 fault, 5 age."""
        n = self.robot.n
        return self.sink.records()[:, 1 + row * n : 1 + (row + 1) * n]

    def off(self) -> bool:
        """Whether torque is off and brakes are closed."""
        plant = self.rig.plant
        return not (plant.command.any() or plant.released.any() or plant.v.any())


@pytest.fixture(params=["lock-step", "wall time"])
def bench(request: pytest.FixtureRequest) -> Bench:
    return Bench(request.param == "wall time")


def test_every_tick_is_one_step_whatever_is_sent(bench: Bench) -> None:
    bench.link.start(bench.configure())
    assert (bench.rig.steps, bench.rig.t) == (0, 0.0)  # set-up takes no rig time
    bench.link.goal = GOAL_OPERATE
    for k in range(12):  # asking, position mode, and from the tenth on stopping
        if k == 8:
            bench.link.goal = GOAL_STOP
        bench.exchange()
        assert bench.rig.steps == k + 1
        assert bench.rig.t == pytest.approx(k * PERIOD_S)
        assert not bench.link.age.any()
        bench.link.command(np.zeros(6))
    assert np.diff(bench.sink.records()[:, 0]) == pytest.approx([PERIOD_S] * 11)
    assert bench.off()


def test_set_up_again_changes_nothing(bench: Bench) -> None:
    first, again = bench.configure(), bench.configure()
    assert np.array_equal(first.counts, again.counts)
    assert np.array_equal(first.statusword, again.statusword)
    assert (bench.rig.steps, len(bench.sink)) == (0, 0)


def test_torque_is_actuated_at_the_next_tick_and_not_before(bench: Bench) -> None:
    bench.enable(np.zeros(6))
    step = np.array([scale.torque_per_count for scale in scales_of(bench.drives)])
    for value in (5.0, -3.0, 7.0):
        before = bench.rig.plant.command.copy()
        bench.link.command(np.full(6, value))
        assert np.array_equal(bench.rig.plant.command, before)
        sent = bench.link.sent.copy()
        assert np.all(np.abs(sent - value) <= 0.5 * step * (1 + 1e-9))
        bench.exchange()
        np.testing.assert_allclose(bench.rig.plant.command, sent, rtol=1e-12)


def test_measurements_are_of_the_moment_of_the_tick(bench: Bench) -> None:
    bench.enable(np.full(6, 4.0))
    for _ in range(5):
        bench.link.command(np.full(6, 4.0))
        bench.exchange()
        assert np.abs(bench.column(1)[-1]).max() > 0.0  # it moves
        error = np.abs(bench.link.q - bench.column(0)[-1])
        assert np.all(error <= 2 * np.pi / 2**19)  # the encoder's step; a float adds nothing


def test_command_age_is_one_cycle_and_grows_without_commands(bench: Bench) -> None:
    first = slice(0, 3)  # in wall time the record is made at the first bus's commands
    bench.enable(np.zeros(6))
    bench.exchange()
    assert np.all(bench.column(5)[-1, first] == 1.0)
    bench.link.goal = GOAL_STOP
    for _ in range(2):
        bench.link.command(np.zeros(6))
        bench.exchange()
    assert np.all(bench.column(5)[-1, first] > 1.0)


def test_watchdog_fires_without_frames_in_wall_time() -> None:
    bench = Bench(wall=True)
    bench.enable(np.full(6, 4.0))
    bench.exchange()
    last = bench.rig.t
    deadline = bench.clock.time + round(WATCHDOG_S * 1e9) + 3 * PERIOD_NS
    while not bench.off():
        assert bench.clock.time < deadline
        bench.clock.time += 2 * PERIOD_NS
        assert bench.rig.overdue(bench.clock.time)
        bench.rig.idle_wall(bench.clock.time)
    assert bench.rig.t >= last + WATCHDOG_S - PERIOD_S - 1e-9
    assert not bench.rig.drives.operation_enabled.any()
    bench.rig.idle_wall(bench.clock.time + 2 * PERIOD_NS)
    assert not bench.column(2)[-1].any()


def test_lock_step_time_stands_without_a_barrier() -> None:
    bench = Bench(wall=False)
    bench.enable(np.full(6, 4.0))
    before = bench.rig.t
    for _ in range(100):
        bench.rig.service_lockstep(range(2))
    assert bench.rig.t == before
    assert bench.rig.plant.released.all()


def test_shut_down_is_confirmed_after_the_loop_and_in_the_middle_of_it(bench: Bench) -> None:
    bench.enable(np.full(6, 4.0))
    bench.link.abandon()
    assert not bench.rig.drives.operation_enabled.any()
    assert bench.setup().shutdown() == ()
