"""``dftc control``: the controller alone, for real drives or a rig that runs elsewhere."""

from __future__ import annotations

import functools
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from canopen.sdo.exceptions import SdoCommunicationError
from cyclopts import Parameter

from dftc_rt.bus import unix
from dftc_rt.bus.directory import check_directory, resolve_directory
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.bus.link_kind import link_kind
from dftc_rt.bus.python_can_socket import open_python_can
from dftc_rt.bus.select import vcan_name
from dftc_rt.bus.socketcan import SocketCanSocket
from dftc_rt.cli import session
from dftc_rt.cli.hil import finish
from dftc_rt.cli.output import log_file
from dftc_rt.cli.processes import roles
from dftc_rt.cli.processes.child import Flags
from dftc_rt.cli.processes.launcher import Launcher
from dftc_rt.cli.processes.roles import Rings
from dftc_rt.cli.session import Session
from dftc_rt.cli.simulate import warm_up
from dftc_rt.cli.status import Status
from dftc_rt.drives.wiring import bus_names, fd_bitrate
from dftc_rt.errors import BusError, DriveError, EnvironmentLacksError, InputError

_EXPECTED = (
    "unix, vcan, socketcan:can0,can1,… or python-can:INTERFACE:CHANNEL,CHANNEL,…, one for each bus"
)


def control(
    scenario: str | Path,
    *,
    bus: str,
    bus_dir: str | Path | None = None,
    lockstep: bool = False,
    log: str | Path | None = None,
    set_: Sequence[str] = (),
    report: Annotated[bool, Parameter(negative="--no-report")] = True,
    json: bool = False,
) -> int:
    """Control drives on a bus that is named outright: this moves whatever is there.

    Example::

        dftc control panda_shoulder_loss --bus unix

    Args:
        scenario: Scenario file, or the name of a shipped one; its [rig] and faults are
            the rig's affair and unused here.
        bus: unix, vcan, socketcan:can0,can1,… with one interface for each of the robot's
            buses, in their order, or python-can:INTERFACE:CHANNEL,CHANNEL,… for adapters
            that have no SocketCAN driver. There is no default.
        bus_dir: Directory of the user-space buses; default as for ``dftc rig``.
        lockstep: Pace by barriers; the rig must run in lock-step too.
        log: MCAP file to write; default: logs/SCENARIO-TIME.mcap.
        set_: Override a key, ``a.b=value``; may be repeated.
        report: Write an HTML report beside the log.
        json: Print one JSON object on stdout.

    Returns:
        Exit code.

    Raises:
        InputError: The scenario or the bus is wrong.
        EnvironmentLacksError: The machine lacks what was asked for.
    """
    opened = session.open_session(scenario, set_)
    if bus.startswith(("socketcan:", "python-can:")) and opened.scenario.control.law == "oracle":
        # It would raise the torque of a healthy joint to make up for a fault that is not there.
        raise InputError("control.law", "oracle on real drives", "a law that nobody tells faults")
    join = functools.partial(_join, opened, scenario, bus, bus_dir)
    for socket in join():  # fail here, in one line, rather than in a child
        socket.close()
    with log_file(opened, log, report=report) as path:
        warm_up(opened)
        rings, flags = Rings.create(opened), Flags()
        epoch_ns = 0 if lockstep else time.time_ns()
        print(f"bus: {bus}", file=sys.stderr, flush=True)

        def controller() -> dict[str, Any]:
            try:
                return roles.controller(opened, join, rings, flags, lockstep=lockstep)
            except DriveError as error:
                if not isinstance(error.__cause__, SdoCommunicationError):
                    raise  # a drive that answers is not what it should be
                raise EnvironmentLacksError(str(error), _how_to_get_drives(bus, scenario)) from None

        with Status(opened, quiet=json or lockstep) as status:
            ended = Launcher(
                rings,
                flags,
                controller,
                None,
                lambda file: roles.recorder(opened, file, epoch_ns, rings, with_rig=False),
                path,
                status.watch,
                real_time=not lockstep,
            ).run()
        return finish(opened, ended, report=report, json=json)


def _join(
    opened: Session, scenario: str | Path, bus: str, bus_dir: str | Path | None
) -> list[FrameSocket]:
    """Open every bus.

    Raises:
        InputError: The bus is not spelled as it must be, or is not what it says.
        EnvironmentLacksError: A bus is not there, or down.
    """
    names, table = bus_names(opened.robot.joint_config), opened.scenario.bus
    if bus == "unix":
        return _join_rig(names, resolve_directory(bus_dir), scenario)
    if bus == "vcan":
        interfaces = [vcan_name(name) for name in names]
        for interface in interfaces:
            if link_kind(interface) != "vcan":
                raise EnvironmentLacksError(
                    f"no vcan interface {interface}",
                    f"ip link add {interface} type vcan && ip link set {interface} up, as root",
                )
    elif bus.startswith("socketcan:"):
        interfaces = _one_each(bus, bus.removeprefix("socketcan:"), names)
    elif bus.startswith("python-can:"):
        return _join_python_can(opened, bus, names)
    else:
        raise InputError("--bus", f"'{bus}'", _EXPECTED)
    fd = fd_bitrate(table) is not None
    try:
        return [SocketCanSocket(n, i, fd=fd) for n, i in zip(names, interfaces, strict=True)]
    except BusError as error:
        kind = "" if bus == "vcan" else f" type can bitrate {table.bitrate}"
        if kind and fd:
            kind += f" dbitrate {table.data_bitrate} fd on"
        raise EnvironmentLacksError(
            str(error), f"ip -br link shows what there is; ip link set NAME up{kind}, as root"
        ) from None


def _one_each(bus: str, given: str, names: Sequence[str]) -> list[str]:
    """Split a list of interfaces or channels that has to have one for each bus."""
    found = given.split(",")
    if len(found) != len(names) or not all(found):
        what, expected = f"'{bus}' names {len(found)}", f"{len(names)}, for {', '.join(names)}"
        raise InputError("--bus", what, expected)
    return found


def _join_python_can(opened: Session, bus: str, names: Sequence[str]) -> list[FrameSocket]:
    """Open every bus through python-can."""
    interface, colon, channels = bus.removeprefix("python-can:").partition(":")
    if not interface or not colon:
        raise InputError("--bus", f"'{bus}'", "python-can:INTERFACE:CHANNEL,CHANNEL,…")
    sockets: list[FrameSocket] = []
    table = opened.scenario.bus
    try:
        for name, channel in zip(names, _one_each(bus, channels, names), strict=True):
            sockets.append(
                open_python_can(name, interface, channel, table.bitrate, fd_bitrate(table))
            )
    except BusError as error:
        for socket in sockets:
            socket.close()
        raise EnvironmentLacksError(
            str(error), "is the adapter plugged in, and its driver there?"
        ) from None
    return sockets


def _join_rig(names: Sequence[str], directory: Path, scenario: str | Path) -> list[FrameSocket]:
    """Open every bus of a rig on this machine.

    Raises:
        InputError: Somebody else could have made the directory.
        EnvironmentLacksError: No rig is there.
    """
    remedy = f"start one first: dftc rig {scenario} --bus unix --bus-dir {directory}"
    if not os.path.lexists(directory):
        raise EnvironmentLacksError(f"no rig has its buses at {directory}", remedy)
    check_directory(directory)
    try:
        return [unix.connect(name, directory) for name in names]
    except BusError as error:
        raise EnvironmentLacksError(str(error), remedy) from None


def _how_to_get_drives(bus: str, scenario: str | Path) -> str:
    if bus in ("unix", "vcan"):
        return f"is the rig of this very scenario there? dftc rig {scenario} --bus {bus}"
    return "check power, wiring, bit rate, and the node ids in robot.toml"
