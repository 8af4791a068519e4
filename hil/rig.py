"""The rig: emulated drives on their buses, around the true robot.

One step is one control period of the plant, then one latch of all drives. In lock-step a
step ends when every bus has seen the controller's barrier, and several SYNCs of one cycle
(one a bus) are one step. In wall time the plant is integrated up to the moment of SYNC, to
the nearest substep. For drives without SYNC the first command of a cycle takes its place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Final, Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.barrier import OUTSIDE
from dftc_rt.bus.frame import frame_buffer
from dftc_rt.config.faults import Fault
from dftc_rt.config.scenario import Scenario
from dftc_rt.drives.wiring import bus_members, bus_names, frame_size
from dftc_rt.dynamics.model import Robot
from dftc_rt.errors import InputError
from hil.bus.impairments import Impairments, check_nodes, of_bus
from hil.bus.paced_bus import PacedBus
from hil.bus.paced_impairments import PacedImpairments
from hil.bus.port import BusPort
from hil.drive import slots
from hil.drive.brakes import Brakes
from hil.drive.failures import DriveFailures, check_failures
from hil.drive.select import emulated_drives
from hil.drive.sensor_faults import SensorFaults
from hil.drive.sensors import Sensors, torque_commands
from hil.faults import compile_faults
from hil.plants.closed_form import refuse_additions
from hil.plants.friction import joint_parameters
from hil.plants.outside import check_outside
from hil.plants.per_joint import per_joint
from hil.plants.rigid_body import RigidBodyPlant

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_CAPACITY: Final = 512
_CATCH_UP_PERIODS: Final = 20  # more than this at once: the rig itself was not scheduled
NS: Final = 1_000_000_000


class RecordSink(Protocol):
    """Where the truth goes, one record a step."""

    def slot(self) -> F64:
        """Return where to write the next record, (1 + 6 n,)."""
        ...

    def commit(self) -> bool:
        """Hand the slot over."""
        ...


EventFunction = Callable[[float, int, str, str], object]
"""Called as (t, severity, source, text)."""


@numba.njit(cache=True)
def _record(
    t: float, q: F64, v: F64, rows: F64, commands: I64, last: I64, age: F64, out: F64
) -> None:
    """Fill one record of ``/rig``: t, then rows q, v, tau_applied, rho, fault, cmd_age."""
    n = q.shape[0]
    out[0] = t
    for i in range(n):
        age[i] = 1.0 if commands[i] != last[i] else age[i] + 1.0
        last[i] = commands[i]
        out[1 + i] = q[i]
        out[1 + n + i] = v[i]
        out[1 + 2 * n + i] = rows[2, i]
        out[1 + 3 * n + i] = rows[3, i]
        out[1 + 4 * n + i] = rows[4, i]
        out[1 + 5 * n + i] = age[i]


class Rig:
    """Drives, buses and plant.

    Driven by :meth:`service_lockstep`, :meth:`service_wall` or, on paced buses,
    :meth:`service_paced`.

    Attributes:
        plant: The true robot.
        drives: The emulated drives.
        ports: Their end of each bus.
        steps: Steps done, 0 before the first SYNC.
        each_step: Called at every step with rig time, s, before faults act; never blocks.
    """

    def __init__(
        self,
        scenario: Scenario,
        robot: Robot,
        ports: Sequence[BusPort],
        q0: F64,
        v0: F64,
        sink: RecordSink,
        event: EventFunction,
    ) -> None:
        """Power the rig on: brakes closed, drives in their default mapping.

        Args:
            scenario: The resolved scenario.
            robot: What the controller believes; the plant differs as the scenario says.
            ports: One a bus, in the order of ``bus_names``.
            q0: True initial position, (n,), rad.
            v0: True initial velocity once the brakes open, (n,), rad/s.
            sink: Takes one record a step.
            event: Takes events.

        Raises:
            InputError: A value of ``[rig]`` or a fault does not fit the robot.
        """
        n = robot.n
        names = bus_names(robot.joint_config)
        self._joints, self._profile = robot.joints, scenario.bus.profile
        self._period = 1.0 / scenario.executor.rate_hz
        self._substeps = scenario.rig.plant.substeps
        faults = compile_faults(scenario.fault, robot.joints)
        self.plant = RigidBodyPlant(
            robot, scenario.rig.plant, scenario.rig.drive, faults, self._period, q0, v0
        )
        self.drives, table = emulated_drives(scenario, robot)
        self._scale = table.values
        self._brakes = Brakes(n, scenario.rig.drive.brake_close_s)
        self._sensors = Sensors(scenario.rig.drive, table, scenario.seed, n)
        self._sensors.preset(self.plant.q, self.drives.objects)
        self._failures = DriveFailures(scenario.fault, robot.joints, self.drives)
        self._sensor_faults = SensorFaults(scenario.fault, robot.joints, table, scenario.seed)
        self.ports = list(ports)
        self._impaired: list[tuple[Impairments, I64]] = []  # with the drives of the bus
        for index, (name, port) in enumerate(zip(names, self.ports, strict=True)):
            if found := of_bus(scenario.fault, name, names):
                kind = PacedImpairments if isinstance(port, PacedBus) else Impairments
                impairments = kind(
                    name, found, scenario.seed, index, event, port.frame_size, robot.joints
                )
                port.impair(impairments)
                self._impaired.append((impairments, bus_members(robot.joint_config, name)))
        self._sink = sink
        self._event = event
        self._inbox = frame_buffer(_CAPACITY, frame_size(scenario.bus))
        self._out = frame_buffer(_CAPACITY, frame_size(scenario.bus))
        self._synced = [False] * len(names)
        self._cycling = [False] * len(names)  # in lock-step: whether a barrier will come
        self._last_commands = np.zeros(n, dtype=np.int64)
        self._age = np.zeros(n)
        self.steps = 0
        self._dt_ns = self._period / self._substeps * NS
        # At most half of what a watchdog waits: a stall of this process alone fires none.
        limit = min(_CATCH_UP_PERIODS * self._period, 0.5 * scenario.rig.drive.watchdog_s)
        self._catch_up = max(int(limit / self._period), 3) * self._substeps
        self._origin = 0  # wall time of rig time 0, ns
        self._substeps_done = 0
        self._last_step = 0  # wall time of the last step, ns
        self.stalls = 0
        self.each_step: Callable[[float], object] | None = None

    def change_faults(self, faults: Sequence[Fault]) -> None:
        """Have other faults of joints, arm, drives and sensors from now on; those of buses stay.

        Args:
            faults: As a scenario has them, in rig time; those of buses are passed over.

        Raises:
            InputError: One does not fit the robot; nothing changes.
        """
        table = compile_faults(faults, self._joints)
        check_failures(faults, self._profile)
        self.plant.change_faults(table)
        self._failures.change(faults)
        self._sensor_faults.change(faults)

    @property
    def t(self) -> float:
        """Rig time, s: 0 at the first SYNC."""
        return self.plant.t

    # -- lock-step ----------------------------------------------------------------------

    def service_lockstep(self, ready: Iterable[int]) -> None:
        """Take what has come; step once every bus has seen the controller's barrier.

        Args:
            ready: Indices of the buses on which something has come.

        Raises:
            BusError: A bus has gone away.
        """
        for bus in ready:
            self._take(bus)
            self._outside(bus)
        for port in self.ports:
            if not port.barrier_pending:
                return
        cycles = [port.pop_barrier() for port in self.ports]
        self._cycling = [True] * len(self.ports)
        if any(self._synced):
            if self.steps:
                self.plant.advance(self._substeps)
            self._latch()
            for bus, port in enumerate(self.ports):
                self._answer(bus, port)
                self._synced[bus] = False
        for port, cycle in zip(self.ports, cycles, strict=True):
            port.send_barrier(cycle or 0)

    def _outside(self, bus: int) -> None:
        """Answer barriers that end no cycle; what comes behind one is of none either."""
        port = self.ports[bus]
        while (cycle := port.barrier_cycle) is not None and cycle >= OUTSIDE:
            port.pop_barrier()
            if self._synced[bus]:  # a cycle that nobody will end
                self._synced[bus] = False
                self._answer(bus, port)
            self._cycling[bus] = False
            port.send_barrier(cycle)
            self._take(bus)

    # -- wall time ----------------------------------------------------------------------

    def service_wall(self, now: int, ready: Sequence[int]) -> None:
        """Take what has come and answer at once; the plant follows the clock.

        Args:
            now: CLOCK_MONOTONIC, ns.
            ready: Indices of the buses on which something has come.

        Raises:
            BusError: A bus has gone away.
        """
        synced = False
        for bus in ready:
            count = len(self._inbox)
            while count == len(self._inbox):  # more than that may wait, and wake nobody
                count = self.ports[bus].receive(self._inbox)
                row = 0
                while row < count:
                    row = self.drives.receive(bus, self._inbox, row, count)
                    synced = synced or self._starts_cycle()
        if synced:
            self._start_cycle(now)
        for bus in ready:
            self._answer(bus, self.ports[bus])
        if not synced:
            self.integrate_ahead()

    def service_paced(self, bus: int, port: PacedBus) -> None:
        """Take what is through on one bus by now, and answer each frame when it was through.

        Args:
            bus: Index of the bus.
            port: Its port.

        Raises:
            BusError: The bus has gone away.
        """
        while count := port.receive(self._inbox):
            row = 0
            while row < count:
                row = self.drives.receive(bus, self._inbox, row, count)
                if self._starts_cycle():
                    self._start_cycle(port.moment)
            self._answer(bus, port)

    def _starts_cycle(self) -> bool:
        """Whether what the drives have just taken starts a cycle; in wall time nobody says so."""
        return bool(self.drives.synced or (self.steps > 0 and self.drives.switched))

    def _start_cycle(self, now: int) -> None:
        """Step up to a SYNC at ``now``, ns."""
        if not self.steps or now - self._last_step > 0.5 * self._period * NS:
            self._step_wall(now)
        else:  # SYNC on a further bus in the same cycle: the same step, its own commands
            self._actuate()

    def integrate_ahead(self) -> None:
        """Use the time between SYNCs: integrate up to the moment at which the next is due.

        What acts until then was fixed at the last SYNC, so nothing is anticipated, and the
        answer to the next SYNC does not have to wait for the plant.
        """
        if not self.steps:
            return
        target = round((self._last_step + self._period * NS - self._origin) / self._dt_ns)
        if target > self._substeps_done:
            self.plant.advance(target - self._substeps_done)
            self._substeps_done = target

    def idle_wall(self, now: int) -> None:
        """Let time pass without SYNC: the plant moves on and the watchdogs run.

        Args:
            now: CLOCK_MONOTONIC, ns.
        """
        if not self.steps:
            return
        self._step_wall(now)
        for bus, port in enumerate(self.ports):
            self._answer(bus, port)

    @property
    def patience_s(self) -> float:
        """How long to wait for a SYNC before :meth:`idle_wall`, s."""
        return 2.0 * self._period if self.steps else 0.1

    def overdue(self, now: int) -> bool:
        """Return whether the last step was so long ago that time must pass without SYNC."""
        return self.steps > 0 and now - self._last_step >= 2.0 * self._period * NS

    def _step_wall(self, now: int) -> None:
        if not self.steps:
            self._origin = now
        due = round((now - self._origin) / self._dt_ns) - self._substeps_done
        most = self._catch_up
        if due > most:
            # Nobody let this process run: that is the host's doing, not the drives'.
            self._origin += round((due - self._substeps) * self._dt_ns)
            self._event(self.t, 2, "rig", f"not scheduled for {due * self._dt_ns / NS:.3f} s")
            self.stalls += 1
            due = self._substeps
        if due > 0:
            self.plant.advance(due)
            self._substeps_done += due
        self._last_step = now
        self._latch()

    # -- shared -------------------------------------------------------------------------

    def _take(self, bus: int) -> None:
        """Hand over what has come on one bus; what is of no cycle is answered at once."""
        port, drives = self.ports[bus], self.drives
        count, some = len(self._inbox), False
        while count == len(self._inbox):  # more than that may wait, and wake nobody
            count = port.receive(self._inbox)
            some = some or count > 0
            row = 0
            while row < count:
                row = drives.receive(bus, self._inbox, row, count)
                if drives.synced or (self._cycling[bus] and drives.switched):
                    self._synced[bus] = True
        if some and not self._synced[bus]:
            self._answer(bus, port)

    def _latch(self) -> None:
        """End a step: timers, new torque commands and brakes, sensors, the record."""
        plant, drives = self.plant, self.drives
        t = plant.t
        if self.each_step is not None:
            self.each_step(t)
        self._failures.apply(t)
        drives.tick(t)
        plant.reveal()
        _record(
            t,
            plant.q,
            plant.v,
            plant.rows,
            drives.commands,
            self._last_commands,
            self._age,
            self._sink.slot(),
        )
        self._sink.commit()
        for port in self.ports:
            port.advance(t)
        for impairments, members in self._impaired:
            for d in members:  # a node that is off the bus does not hear, either
                off = slots.BUS_OFF if impairments.off(int(d)) else 0
                others = drives.objects[d, slots.OFF_BUS] & ~slots.BUS_OFF
                drives.objects[d, slots.OFF_BUS] = others | off
        self._actuate()
        self._sensors.latch(plant.q, plant.v, plant.motor, drives.objects)
        self._sensor_faults.apply(t, drives.objects)
        self.steps += 1

    def _actuate(self) -> None:
        """Put the commands in force into the motors and the brakes."""
        plant, drives = self.plant, self.drives
        torque_commands(drives.objects, self._scale, plant.command)
        if self._brakes.move(plant.t, drives.objects, plant.released):
            plant.set_brakes(self._brakes.is_open)

    def _answer(self, bus: int, port: BusPort) -> None:
        count = self.drives.answer(bus, self._out)
        if count:
            port.send(self._out, count, self.drives.senders)


def check_rig(scenario: Scenario, robot: Robot) -> None:
    """Check what the rig's process would refuse, before there is one.

    Raises:
        InputError: A value of ``[rig]`` or a fault does not fit the robot.
    """
    check_outside(robot, compile_faults(scenario.fault, robot.joints))
    check_failures(scenario.fault, scenario.bus.profile)
    names = bus_names(robot.joint_config)
    for name in names:
        of_bus(scenario.fault, name, names)
    check_nodes(scenario.fault, robot.joint_config)
    initial_state(scenario, robot, np.zeros((2, robot.n)))
    plant = scenario.rig.plant
    joint_parameters(robot, plant)
    if plant.armature is not None:
        per_joint(plant.armature, robot.n, "rig.plant.armature")
    if robot.closed_form is not None:
        refuse_additions(robot.closed_form, plant)


def initial_state(scenario: Scenario, robot: Robot, on_reference: F64) -> tuple[F64, F64]:
    """Return true initial position and velocity, (n,) each.

    Args:
        scenario: The scenario.
        robot: The robot.
        on_reference: Desired position and velocity at t = 0, rows 0 and 1.

    Raises:
        InputError: ``q0_rad`` or ``v0_rad_s`` does not have a value per joint.
    """
    plant = scenario.rig.plant
    q0 = on_reference[0].copy()
    v0 = on_reference[1].copy() if scenario.reference.blend_s == 0 else np.zeros(robot.n)
    if plant.q0_rad is not None:
        q0 = _one_per_joint(plant.q0_rad, robot.n, "rig.plant.q0_rad")
    if plant.v0_rad_s is not None:
        v0 = _one_per_joint(plant.v0_rad_s, robot.n, "rig.plant.v0_rad_s")
    return q0, v0


def _one_per_joint(values: tuple[float, ...], n: int, where: str) -> F64:
    if len(values) != n:
        raise InputError(where, f"{len(values)} values", f"{n}, one per joint")
    return np.array(values, dtype=np.float64)
