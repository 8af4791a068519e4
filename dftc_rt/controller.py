"""The controller, put together from a scenario: everything on its side of the wire."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus import budget
from dftc_rt.bus.frame import frame_buffer
from dftc_rt.bus.inprocess import link as in_process_link
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.config.calibration import Calibration, calibration_gains, load_calibration
from dftc_rt.config.identification import (
    Identification,
    check_identification,
    check_range,
    identification_gains,
    load_identification,
)
from dftc_rt.config.robot import RobotConfig
from dftc_rt.config.scenario import Scenario
from dftc_rt.control import laws, settings, signals
from dftc_rt.control.dftc import Dftc
from dftc_rt.control.interface import Law
from dftc_rt.drives.interface import SetUp, profile
from dftc_rt.drives.scale import ScaleTable, torque_grid
from dftc_rt.drives.wiring import bus_members, bus_names, frame_size, robot_drives
from dftc_rt.dynamics.calibrated import calibrated
from dftc_rt.dynamics.interface import JointTerms
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.payload import with_unit_load
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.select import lagrangian_terms, local_terms, whole_body
from dftc_rt.dynamics.tabulated import TabulatedTerms, refuse_closed_form
from dftc_rt.effectiveness import schedule
from dftc_rt.errors import InputError
from dftc_rt.reference import Reference, stop_ramp
from dftc_rt.ring import Ring
from dftc_rt.rt.clock import Clock, FakeClock
from dftc_rt.rt.drive_link import DriveLink
from dftc_rt.rt.executor import WARNING, EventFunction, Executor, RecordSink
from dftc_rt.rt.frame_tap import FrameTap
from dftc_rt.rt.limits import JointLimits, first_loss
from dftc_rt.rt.outside import OutsideCycles
from dftc_rt.rt.supervisor import State, Supervisor

F64 = NDArray[np.float64]

_TABLE_LIMIT_BYTES = 2 << 30


def scenario_robot(scenario: Scenario, stored: tuple[RobotConfig, str] | None = None) -> Robot:
    """Load a scenario's robot, however its buses are loaded.

    A bare URDF does not say how its drives are wired: they get as few buses as will do.

    Args:
        scenario: The scenario.
        stored: What a log holds of the robot, in place of files.

    Raises:
        InputError: Something in the scenario or the robot is wrong.
    """
    table, bus = scenario.robot, scenario.bus
    most = budget.joints_per_bus(
        rate_hz=scenario.executor.rate_hz,
        bitrate=bus.bitrate,
        data_bitrate=bus.data_bitrate,
        profile=bus.profile,
    )
    return load_robot(
        name=table.name,
        urdf=table.urdf,
        plant=table.plant,
        lock=table.lock,
        home_rad=table.home_rad,
        joints_per_bus=table.joints_per_bus,
        unstated_joints_per_bus=max(most, 1),  # a bus that is overloaded is told of later
        stored=stored,
    )


@dataclass(frozen=True)
class Parts:
    """What a controller is made of before it meets its drives.

    Attributes:
        robot: The robot as the controller believes it.
        law: The control law.
        reference: Desired motion.
        terms: Exact local terms.
        scales: Scale of every drive.
        torque_limit: Largest torque that can be commanded, (n,), Nm.
    """

    robot: Robot
    law: Law
    reference: Reference
    terms: JointTerms
    scales: ScaleTable
    torque_limit: F64


def prepare(
    scenario: Scenario,
    robot: Robot,
    calibration: Calibration | None = None,
    identification: Identification | None = None,
) -> Parts:
    """Build and check everything that needs no drive.

    Args:
        scenario: The resolved scenario.
        robot: The nominal robot.
        calibration: In place of the scenario's ``control.calibration``.
        identification: In place of the scenario's ``control.identification``.

    Raises:
        InputError: The scenario does not fit the robot, or a bus would be overloaded.
    """
    check_budget(scenario, robot)
    control = scenario.control
    gains: dict[str, Any] = dict(robot.gains)
    known = {key: value for key, value in gains.items() if key in settings.NAMES}
    _check_gains(known, robot.n, f"robot '{robot.name}': gains")
    where = control.calibration or "calibration"
    if calibration is None and control.calibration is not None:
        calibration = load_calibration(where)
    if calibration is not None:
        robot = calibrated(robot, calibration, where)
        gains |= calibration_gains(calibration, where)
        for index, joint in enumerate(calibration.joint):
            _check_gains(joint.gains, 1, f"{where}: joint[{index}].gains")
    where = control.identification or "identification"
    if identification is None and control.identification is not None:
        identification = load_identification(where)
    if identification is not None:
        gains |= _identified(scenario, robot, identification, calibration, where)
    scales = [drive.scale for drive in robot_drives(robot, scenario.bus)]
    resolution, limit = torque_grid(scales, robot.torque_limit)
    if control.local_terms == "tabulated":
        refuse_closed_form(robot)
    law = laws.build(
        control.law,
        robot.n,
        1.0 / scenario.executor.rate_hz,
        limit,
        resolution,
        np.array([j.delay_cycles for j in robot.joint_config], dtype=np.int64),
        {**gains, **_tuples(control.gains)},
        control.ftc,
        robot.lower,
        robot.upper,
        robot.velocity_limit,
        whole_body(robot).inverse_dynamics,
        None if robot.friction is None else robot.friction.add_to,
        lagrangian_terms(robot),
        schedule(scenario.fault, robot.joints),
        None
        if robot.closed_form is not None
        else whole_body(with_unit_load(robot)).inverse_dynamics,
    )
    if identification is not None and isinstance(law, Dftc):
        joints = law.joints
        lower, upper, speed = joints.q_lower, joints.q_upper, joints.velocity_limit
        check_range(identification, lower, upper, speed, where)
    reference = Reference(scenario.reference, robot.home)
    check_reference(reference, robot, scenario.duration_s)
    terms = local_terms(robot, control.interconnection)
    return Parts(robot, law, reference, terms, ScaleTable.of(scales), limit)


def _identified(
    scenario: Scenario,
    robot: Robot,
    identification: Identification,
    calibration: Calibration | None,
    where: str,
) -> dict[str, Any]:
    """Settings of a law that has networks beside the split; none for one without networks.

    Raises:
        InputError: It was trained on something else, or the law's networks are the whole model.
    """
    control = scenario.control
    check_identification(
        identification, robot.name, robot.joints, control.interconnection, calibration, where
    )
    if control.law == "paper":
        what = "the law 'paper' has networks of its own"
        raise InputError("control.identification", what, "another law")
    if control.gains.get("model", "split") == "rbf":
        what = "control.gains.model = 'rbf': the networks would be the whole model"
        raise InputError("control.identification", what, "'split'")
    return identification_gains(
        identification, control.gains, in_law=control.identification_in_law, where=where
    )


def _check_gains(gains: Mapping[str, Any], n: int, where: str) -> None:
    """Check settings of the law under the name of the file that they come from.

    Raises:
        InputError: A key or a value is wrong.
    """
    try:
        settings.parse(gains, n, printed=False)
    except InputError as error:
        key = error.where.removeprefix("control.gains.")
        raise InputError(f"{where}.{key}", error.what, error.expected) from None


def _tuples(gains: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(v) if isinstance(v, list) else v for key, v in gains.items()}


def bus_loads(scenario: Scenario, robot: Robot) -> list[budget.BusLoad]:
    """Return the load of every bus, however large it is."""
    return [
        budget.bus_load(
            name,
            int(bus_members(robot.joint_config, name).size),
            rate_hz=scenario.executor.rate_hz,
            bitrate=scenario.bus.bitrate,
            data_bitrate=scenario.bus.data_bitrate,
            profile=scenario.bus.profile,
        )
        for name in bus_names(robot.joint_config)
    ]


def check_budget(scenario: Scenario, robot: Robot) -> list[budget.BusLoad]:
    """Return the load of every bus.

    Raises:
        InputError: The worst case exceeds what a bus may carry, and ``bus.overload`` refuses that.
    """
    loads = bus_loads(scenario, robot)
    if scenario.bus.overload == "refuse":
        budget.check(loads, scenario.bus.profile)
    return loads


def read_budget_s(scenario: Scenario, loads: Sequence[budget.BusLoad]) -> float:
    """Return how long after the tick the controller waits for answers, s; for all buses."""
    share = scenario.executor.read_budget
    if share == "auto":
        return max(budget.read_budget_s(load) for load in loads)
    return share / scenario.executor.rate_hz


def joint_limits(parts: Parts) -> JointLimits:
    """Return what each joint may do, as the supervisor needs it."""
    robot = parts.robot
    return JointLimits(robot.lower, robot.upper, robot.velocity_limit, parts.torque_limit)


def check_pose(robot: Robot, q: F64) -> None:
    """Refuse to start from a pose that is none, as with an encoder whose zero is elsewhere.

    Args:
        robot: The robot.
        q: Measured position, (n,), rad.

    Raises:
        InputError: A joint is outside of its limits.
    """
    for i, drive in enumerate(robot.joint_config):
        if not robot.lower[i] <= q[i] <= robot.upper[i]:
            raise InputError(
                f"{drive.name} (node {drive.node_id} on {drive.bus})",
                f"is at {_short(q[i])} rad",
                f"{robot.lower[i]:.3f} to {robot.upper[i]:.3f} rad; move it there by hand, or "
                "correct zero_offset_rad and sign in robot.toml",
            )


def check_reference(reference: Reference, robot: Robot, duration_s: float) -> None:
    """Refuse a reference that leaves the robot's limits, sampled at 100 Hz.

    Raises:
        InputError: Position or velocity exceeds a joint's limit; says which and when.
    """
    times = np.arange(0.0, min(duration_s, 600.0), 0.01)
    motion = reference.table(times)
    q, v = motion[:, 0], motion[:, 1]
    with np.errstate(invalid="ignore"):
        outside = (q < robot.lower) | (q > robot.upper) | (np.abs(v) > robot.velocity_limit)
    if not outside.any():
        return
    k, i = (int(x) for x in np.argwhere(outside)[0])
    if q[k, i] < robot.lower[i] or q[k, i] > robot.upper[i]:
        found = f"{_short(q[k, i])} rad"
        expected = f"{robot.lower[i]:.3f} to {robot.upper[i]:.3f} rad"
    else:
        found = f"{_short(v[k, i])} rad/s"
        expected = f"at most {robot.velocity_limit[i]:.3f} rad/s"
    raise InputError(
        "reference", f"{robot.joints[i]} would be at {found} at t = {times[k]:.2f} s", expected
    )


def _short(value: float) -> str:
    """A number for a message: as people write it, as long as that is short."""
    return f"{value:.3f}" if abs(value) < 1e6 else f"{value:g}"


def connect(
    scenario: Scenario,
    parts: Parts,
    sockets: Sequence[FrameSocket],
    clock: Clock,
    sink: RecordSink,
    event: EventFunction,
    stop_requested: Callable[[], bool],
    frames: Ring | None = None,
) -> Executor:
    """Configure the drives, take the measured pose, and return an executor ready to run.

    Args:
        scenario: The resolved scenario.
        parts: From :func:`prepare`.
        sockets: One a bus, in the order of ``bus_names``.
        clock: Real, lock-step or fake.
        sink: Takes the records.
        event: Takes events.
        stop_requested: Polled once a cycle.
        frames: Takes every frame that passes the sockets, of set-up too; None: nobody listens.

    Raises:
        DriveError: A drive is missing, or is not what the robot file says.
        BusError: A bus has gone away.
    """
    robot = parts.robot
    budget_s = read_budget_s(scenario, check_budget(scenario, robot))
    warm_up(scenario, parts)
    chosen = profile(scenario.bus.profile)
    drives = robot_drives(robot, scenario.bus)
    rate = scenario.executor.rate_hz
    tap = None
    if frames is not None:
        tap = FrameTap(frames, clock, 1.0 / rate, frame_size(scenario.bus))
        sockets = tap.tapped(sockets)
    setup = chosen.setup(sockets, drives, rate)
    if clock.lockstep:
        setup = OutsideCycles(setup, sockets, frame_size(scenario.bus))
    try:
        found = setup.configure()
        # Around drives that are switched on, not enabled.

        def report(source: str, text: str) -> None:
            event(executor.t, WARNING, source, text)

        link = DriveLink(
            sockets,
            chosen.cycle(drives, len(sockets), rate),
            clock,
            budget_s,
            report,
            frame_size(scenario.bus),
            scenario.supervisor.stale_cycles,
            parts.torque_limit,
        )
        link.start(found)
        executor = assemble(
            scenario, parts, link, clock, sink, event, stop_requested, setup.shutdown
        )
        if tap is not None:
            tap.follow(executor)
        return executor
    except BaseException:
        setup.shutdown()
        raise


def assemble(
    scenario: Scenario,
    parts: Parts,
    link: DriveLink,
    clock: Clock,
    sink: RecordSink,
    event: EventFunction,
    stop_requested: Callable[[], bool],
    shutdown: Callable[[], Sequence[str]],
) -> Executor:
    """Put the executor together around a link whose pose is known.

    Args:
        scenario: The resolved scenario.
        parts: From :func:`prepare`.
        link: The drives, or what a log holds of them.
        clock: Real, lock-step, fake, or that of a log.
        sink: Takes the records.
        event: Takes events.
        stop_requested: Polled once a cycle.
        shutdown: Takes power off every drive after the loop.

    Raises:
        InputError: From this pose the reference leaves the limits, or its table is too large.
    """
    check_pose(parts.robot, link.q)
    parts.reference.start(link.q)
    check_reference(parts.reference, parts.robot, scenario.duration_s)  # now with the real start
    table = _tabulate(scenario, parts) if scenario.control.local_terms == "tabulated" else None
    return Executor(
        scenario, parts.robot.joints, joint_limits(parts), clock, link, parts.law, parts.reference,
        parts.terms, table, sink, event, stop_requested, shutdown,
    )  # fmt: skip


def _tabulate(scenario: Scenario, parts: Parts) -> TabulatedTerms | None:
    """Tabulate the local terms along the reference, whose start is known by now."""
    rate = scenario.executor.rate_hz
    cycles = max(round(scenario.duration_s * rate), 1)
    size = cycles * 4 * parts.robot.n * 8
    if size > _TABLE_LIMIT_BYTES:
        raise InputError(
            "control.local_terms",
            f"'tabulated' would take {size / 2**30:.1f} GiB for {scenario.duration_s} s",
            "'exact', or a shorter run",
        )
    motion = parts.reference.table(np.arange(cycles) / rate)
    table = TabulatedTerms(
        parts.robot,
        scenario.control.interconnection,
        *(np.ascontiguousarray(motion[:, row]) for row in range(3)),
    )
    table.update(0, parts.robot.home, parts.robot.home)  # compiles
    return table


def warm_up(scenario: Scenario, parts: Parts) -> None:
    """Call everything the loop calls once, so that nothing compiles or loads in it."""
    robot, n = parts.robot, parts.robot.n
    drives = robot_drives(robot, scenario.bus)
    size = frame_size(scenario.bus)
    pairs = [in_process_link(name, frame_size=size) for name in bus_names(robot.joint_config)]
    cycle = profile(scenario.bus.profile).cycle(drives, len(pairs), scenario.executor.rate_hz)
    link = DriveLink(
        [near for near, _ in pairs], cycle, FakeClock(), 0.0, lambda *_: None, size,
        torque_limit=parts.torque_limit,
    )  # fmt: skip
    link.start(SetUp(np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)))
    feedback = frame_buffer(1, size)
    for bus, (_, far) in enumerate(pairs):
        node = next(drive.node_id for drive in drives if drive.bus == bus)
        feedback.view("<u4")[0, :2] = 0x180 + node, 8
        far.send(feedback, 1)
    supervisor = Supervisor(scenario.supervisor, joint_limits(parts), 1.0)
    rec = np.zeros((len(signals.NAMES), n))
    rec[signals.Q] = rec[signals.QD] = robot.home
    desired = rec[signals.QD : signals.AD + 1]
    parts.law.start(robot.home, np.zeros(n))
    for _ in range(3):
        link.exchange(0, 0)
        parts.reference.sample(0.0, desired)
        stop_ramp(0.0, 1.0, np.zeros((3, n)), desired)
        parts.terms.update(robot.home, rec[signals.V], *desired)
        parts.law.update(rec, parts.terms.inertia, parts.terms.bias, parts.terms.load)
        parts.law.skip(1)
        supervisor.check(rec, link.status, link.emergency, State.IDLE, 0)
        first_loss(rec)
        link.all_enabled()
        link.first_live()
        link.command(rec[signals.TAU_CMD])
