"""The rig between its buses and its plant: steps, delays, watchdogs, time."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.config.faults import LockFault, LossFault, PayloadFault, SilentFault
from dftc_rt.config.scenario import DriveTable, PlantTable, RigTable, RobotTable, Scenario
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import GOAL_OPERATE, SetUp, profile
from dftc_rt.drives.wiring import bus_names, drive_configs
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.errors import InputError
from dftc_rt.memory import MemorySink
from dftc_rt.rt.clock import FakeClock, LockstepClock
from dftc_rt.rt.drive_link import DriveLink
from hil.drive import slots
from hil.simulate import in_process_rig

F64 = NDArray[np.float64]
PERIOD_NS = 1_000_000
PERIOD_S = 1e-3
WATCHDOG_S = 0.010
EMCY_RPDO_TIMEOUT = "0x8250"  # CiA 301, table of emergency error codes


class Bench:
    """A rig, and the controller's end of its buses in the test's hands."""

    def __init__(self, robot: str = "ur5", *, wall: bool = False, **plant: Any) -> None:
        self.robot = load_robot(robot)
        n = self.robot.n
        self.scenario = Scenario(
            name="bench",
            robot=RobotTable(name=robot),
            rig=RigTable(plant=PlantTable(**plant), drive=DriveTable(watchdog_s=WATCHDOG_S)),
        )
        self.sink = MemorySink(1 + 6 * n)
        self.events: list[tuple[float, int, str, str]] = []
        self.emergencies: list[str] = []
        self.clock = FakeClock()
        motion = np.zeros((3, n))
        motion[0] = self.robot.home
        joined = in_process_rig(
            self.scenario, self.robot, motion, self.sink, lambda *e: self.events.append(e),
            self.clock.now if wall else None,
        )  # fmt: skip
        self.rig = joined.rig
        self.sockets = joined.sockets
        self.drives = drive_configs(self.robot.joint_config)
        cycle = profile("cia402").cycle(self.drives, len(self.sockets), 1000.0)
        self.link = DriveLink(
            self.sockets, cycle, self.clock if wall else LockstepClock(), 0.0,
            lambda source, text: self.emergencies.append(text),
        )  # fmt: skip
        self.k = 0

    def configure(self) -> SetUp:
        return profile("cia402").setup(self.sockets, self.drives, 1000.0).configure()

    def enable(self, tau: F64) -> None:
        """Set up, and run until every drive is enabled, with ``tau`` commanded."""
        self.link.start(self.configure())
        self.link.goal = GOAL_OPERATE
        for _ in range(20):
            self.exchange()
            self.link.command(tau)
            if self.link.all_enabled() and self.k > 3:
                return
        raise AssertionError("the drives were not enabled")

    def exchange(self) -> None:
        """One SYNC on every bus, one period after the last."""
        self.clock.time += PERIOD_NS
        self.link.exchange(self.k, self.clock.time)
        self.k += 1

    def column(self, row: int) -> F64:
        """One row of /rig over time, (K, n): 0 q, 1 v, 2 tau_applied, 3 rho, 4 fault, 5 age."""
        n = self.robot.n
        return self.sink.records()[:, 1 + row * n : 1 + (row + 1) * n]

    def off(self) -> bool:
        """Whether torque is off, brakes are closed, and every drive is or goes into fault."""
        plant, drives = self.rig.plant, self.rig.drives
        return (
            not plant.command.any()
            and not plant.released.any()
            and not plant.v.any()
            and bool(np.all(drives.state >= states.FAULT_REACTION_ACTIVE))
        )


@pytest.fixture(params=["lock-step", "wall time"])
def bench(request: pytest.FixtureRequest) -> Bench:
    return Bench(wall=request.param == "wall time")


def test_syncs_of_one_cycle_are_one_step(bench: Bench) -> None:
    assert len(bus_names(bench.robot.joint_config)) == 2
    bench.link.start(bench.configure())
    for k in range(5):
        bench.exchange()
        assert bench.rig.steps == k + 1
        assert bench.rig.t == pytest.approx(k * PERIOD_S)
        assert not bench.link.age.any()
    assert len(bench.sink) == 5
    assert np.diff(bench.sink.records()[:, 0]) == pytest.approx([PERIOD_S] * 4)


def test_command_is_actuated_at_the_next_sync_and_not_before(bench: Bench) -> None:
    bench.enable(np.zeros(6))
    for value in (5.0, -3.0, 7.0):
        tau = np.full(6, value)
        before = bench.rig.plant.command.copy()
        bench.link.command(tau)
        assert np.array_equal(bench.rig.plant.command, before)
        sent = bench.link.sent.copy()
        assert sent == pytest.approx(tau, abs=0.2)
        bench.exchange()
        np.testing.assert_allclose(bench.rig.plant.command, sent, rtol=1e-12)
        assert np.all(bench.column(5)[-1] == 1.0)


def test_command_age_grows_when_commands_cease(bench: Bench) -> None:
    # Only the first bus: in wall time the record is made at its SYNC, and the others follow.
    first = slice(0, 3)
    bench.enable(np.zeros(6))
    bench.exchange()
    for age in (2.0, 3.0, 4.0):
        bench.exchange()
        assert np.all(bench.column(5)[-1, first] == age)
    bench.link.command(np.zeros(6))
    bench.exchange()
    assert np.all(bench.column(5)[-1, first] == 1.0)


def test_watchdog_fires_while_sync_goes_on(bench: Bench) -> None:
    bench.enable(np.full(6, 4.0))
    bench.exchange()
    last = bench.rig.t  # the command came after the SYNC before this one
    while not bench.off():
        assert bench.rig.plant.released.all()
        bench.exchange()
        assert bench.rig.t <= last + WATCHDOG_S + PERIOD_S
    assert bench.rig.t >= last + WATCHDOG_S - PERIOD_S - 1e-9
    bench.exchange()
    assert len(bench.emergencies) == 6
    assert all(EMCY_RPDO_TIMEOUT in text for text in bench.emergencies)
    held = bench.rig.plant.q.copy()
    for _ in range(5):
        assert bench.off()
        assert np.all(bench.rig.drives.state == states.FAULT)
        bench.exchange()
    assert np.array_equal(bench.rig.plant.q, held)
    assert not bench.column(2)[-1].any()


def test_watchdog_fires_without_sync_in_wall_time() -> None:
    bench = Bench(wall=True)
    bench.enable(np.full(6, 4.0))
    last = bench.rig.t
    assert not bench.rig.overdue(bench.clock.time + PERIOD_NS)
    deadline = bench.clock.time + round(WATCHDOG_S * 1e9) + 3 * PERIOD_NS
    while not bench.off():
        assert bench.clock.time < deadline
        bench.clock.time += 2 * PERIOD_NS
        assert bench.rig.overdue(bench.clock.time)
        bench.rig.idle_wall(bench.clock.time)
    assert bench.rig.t >= last + WATCHDOG_S
    t = bench.sink.records()[:, 0]
    assert t[-1] == pytest.approx(bench.rig.t)  # /rig goes on without the controller


def test_lock_step_time_stands_without_a_barrier() -> None:
    bench = Bench()
    bench.enable(np.full(6, 4.0))
    before = bench.rig.t
    for _ in range(100):
        bench.rig.service_lockstep(range(2))
    assert bench.rig.t == before
    assert bench.rig.plant.released.all()


def test_stall_of_the_rig_is_not_charged_to_the_watchdogs() -> None:
    bench = Bench(wall=True)
    bench.enable(np.full(6, 4.0))
    before = bench.rig.t
    bench.clock.time += 1000 * PERIOD_NS  # a hundred watchdogs long
    bench.rig.idle_wall(bench.clock.time)
    assert bench.rig.stalls == 1
    assert bench.rig.t <= before + 2 * PERIOD_S
    assert bench.rig.plant.released.all()
    assert np.all(bench.rig.drives.state == states.OPERATION_ENABLED)
    assert [text for _, _, _, text in bench.events if "not scheduled" in text]
    bench.link.command(np.zeros(6))
    bench.exchange()  # and time goes on from there
    assert bench.rig.t == pytest.approx(before + 2 * PERIOD_S, abs=1.01 * PERIOD_S)


def test_wall_time_follows_the_clock_whatever_the_jitter() -> None:
    bench = Bench(wall=True)
    bench.link.start(bench.configure())
    bench.exchange()
    origin = bench.clock.time
    for late_us in (130, -200, 400, 0, 250, -120):
        bench.clock.time += PERIOD_NS + 1000 * late_us
        bench.link.exchange(bench.k, bench.clock.time)
        lag = (bench.clock.time - origin) * 1e-9 - bench.rig.t
        assert abs(lag) <= 0.5 * bench.rig.plant.dt + 1e-9  # the substep nearest to SYNC


def run(extra_set_ups: int) -> tuple[F64, F64]:
    """A short run after some set-ups: records, and what the controller measured."""
    bench = Bench()
    for _ in range(extra_set_ups):
        bench.configure()
    assert bench.rig.steps == 0
    assert bench.rig.t == 0.0
    assert len(bench.sink) == 0
    measured = []
    bench.enable(np.full(6, 1.0))
    for k in range(30):
        bench.exchange()
        bench.link.command(np.full(6, np.sin(0.3 * k)))
        measured.append((bench.link.q.copy(), bench.link.v.copy()))
    return bench.sink.records(), np.array(measured)


def test_set_up_takes_no_rig_time_and_no_random_numbers() -> None:
    records, measured = run(0)
    again, measured_again = run(2)
    assert np.array_equal(again, records)
    assert np.array_equal(measured_again, measured)
    assert np.ptp(measured[:, 1]) > 0


def test_measurements_are_of_the_moment_of_sync(bench: Bench) -> None:
    bench.enable(np.full(6, 4.0))
    for _ in range(5):
        bench.link.command(np.full(6, 4.0))
        bench.exchange()
        np.testing.assert_allclose(bench.link.q, bench.column(0)[-1], atol=1.3e-5)
    assert bench.rig.drives.objects[0, slots.ENABLED] == 1


def test_faults_change_while_the_rig_runs_and_end() -> None:
    bench = Bench()
    n = bench.robot.n
    bench.enable(np.zeros(n))
    loss = LossFault(joint=bench.robot.joints[1], effectiveness=0.5, start_s=bench.rig.t)
    lock = LockFault(joint=bench.robot.joints[2], start_s=bench.rig.t)
    load = PayloadFault(payload_kg=5.0, start_s=bench.rig.t)
    silent = SilentFault(joint=bench.robot.joints[3], start_s=bench.rig.t)
    bench.rig.change_faults([loss, lock, load, silent])
    for _ in range(3):
        bench.exchange()
    assert bench.rig.plant.rho.tolist() == [1.0, 0.5, 0.0, 1.0, 1.0, 1.0]
    assert bench.rig.plant.fault.tolist() == [1.0] * n
    assert bench.rig.plant.locked.tolist() == [False, False, True, False, False, False]
    assert bench.rig.drives.objects[3, slots.OFF_BUS]
    over = [msgspec.structs.replace(f, end_s=bench.rig.t) for f in (loss, lock, load, silent)]
    bench.rig.change_faults(over)
    for _ in range(3):
        bench.exchange()
    assert bench.rig.plant.rho.tolist() == [1.0] * n
    assert bench.rig.plant.fault.tolist() == [0.0] * n
    assert not bench.rig.plant.locked.any()
    assert not bench.rig.drives.objects[3, slots.OFF_BUS]
    bare = Bench().rig.plant
    q = np.zeros(n)
    assert np.array_equal(bench.rig.plant._dynamics.mass_matrix(q), bare._dynamics.mass_matrix(q))


def test_a_fault_that_does_not_fit_changes_nothing() -> None:
    bench = Bench()
    bench.enable(np.zeros(bench.robot.n))
    with pytest.raises(InputError, match="no joint 'elbow'"):
        bench.rig.change_faults([LossFault(joint="elbow", effectiveness=0.5)])
    bench.exchange()
    assert bench.rig.plant.rho.tolist() == [1.0] * bench.robot.n
