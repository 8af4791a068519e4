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
from dftc_rt.bus.stamped import StampedSocket
from dftc_rt.cli import listen as listening
from dftc_rt.cli import session
from dftc_rt.cli.hil import finish
from dftc_rt.cli.listen_show import show
from dftc_rt.cli.output import log_file
from dftc_rt.cli.processes import roles
from dftc_rt.cli.processes.child import Flags
from dftc_rt.cli.processes.launcher import Launcher
from dftc_rt.cli.processes.roles import Rings
from dftc_rt.cli.session import Session
from dftc_rt.cli.set_up_only import set_up_only as set_up_drives
from dftc_rt.cli.simulate import warm_up
from dftc_rt.cli.status import Status
from dftc_rt.drives.wiring import bus_names, fd_bitrate
from dftc_rt.errors import BusError, DftcError, DriveError, EnvironmentLacksError, InputError

_LISTEN_S = 2.0
_LONGEST_S = 86400.0
_EXPECTED = (
    "unix, vcan, socketcan:can0,can1,… or python-can:INTERFACE:CHANNEL,CHANNEL,…, one for each bus"
)


def control(
    scenario: str | Path,
    *,
    bus: str,
    bus_dir: str | Path | None = None,
    lockstep: bool = False,
    listen: bool = False,
    ask: bool = False,
    duration: float | None = None,
    set_up_only: bool = False,
    log: str | Path | None = None,
    set_: Sequence[str] = (),
    frames: bool = False,
    report: Annotated[bool, Parameter(negative="--no-report")] = True,
    json: bool = False,
) -> int:
    """Control drives on a bus that is named outright: this moves whatever is there.

    With ``--listen`` it moves nothing and sends nothing: it says what is on the buses. With
    ``--set-up-only`` it does all that a run does before it gives torque.

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
        listen: Only listen, and say what stands against a start: exit code 1, else 0.
        ask: With ``--listen``: also ask the drives what they are, which changes nothing.
        duration: With ``--listen``: for how long, s; default: 2.
        set_up_only: Set the drives up, up to switched on but not enabled, and take their power
            off again.
        log: MCAP file to write; default: logs/SCENARIO-TIME.mcap.
        set_: Override a key, ``a.b=value``; may be repeated.
        frames: Log every frame that is sent and received, to /can.
        report: Write an HTML report beside the log.
        json: Print one JSON object on stdout.

    Returns:
        Exit code.

    Raises:
        InputError: The scenario or the bus is wrong.
        EnvironmentLacksError: The machine lacks what was asked for.
    """
    _check_options(listen, ask, duration, set_up_only, lockstep or log is not None)
    opened = session.open_session(scenario, set_)
    if listen:
        return _listen(opened, scenario, bus, bus_dir, duration or _LISTEN_S, ask=ask, json=json)
    if set_up_only:
        return _set_up(opened, scenario, bus, bus_dir, json=json)
    if bus.startswith(("socketcan:", "python-can:")) and opened.scenario.control.law == "oracle":
        # It would raise the torque of a healthy joint to make up for a fault that is not there.
        raise InputError("control.law", "oracle on real drives", "a law that nobody tells faults")
    join = functools.partial(_join, opened, scenario, bus, bus_dir)
    for socket in join():  # fail here, in one line, rather than in a child
        socket.close()
    with log_file(opened, log, report=report) as path:
        warm_up(opened)
        rings, flags = Rings.create(opened, frames=frames), Flags()
        epoch_ns = 0 if lockstep else time.time_ns()
        print(f"bus: {bus}", file=sys.stderr, flush=True)

        def controller() -> dict[str, Any]:
            try:
                return roles.controller(opened, join, rings, flags, lockstep=lockstep)
            except DriveError as error:
                raise _explained(error, bus, scenario) from None

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


def _check_options(
    listen: bool, ask: bool, duration: float | None, set_up_only: bool, others: bool
) -> None:
    """Refuse options that would mean nothing.

    Raises:
        InputError: One of listening without it, another with it, or no time to listen.
    """
    if set_up_only and (listen or others):
        what = "given with --listen, --lockstep or --log"
        raise InputError("--set-up-only", what, "none of them: nothing is run")
    if not listen and (ask or duration is not None):
        what = "--ask" if ask else "--duration"
        raise InputError(
            what, "given without --listen", "--listen, or --set duration_s=S for a run"
        )
    if listen and others:
        raise InputError("--listen", "given with --lockstep or --log", "neither: nothing is run")
    if duration is not None and not 0.0 < duration <= _LONGEST_S:
        raise InputError("--duration", str(duration), f"over 0 and at most {_LONGEST_S:g} s")


def _set_up(
    opened: Session, scenario: str | Path, bus: str, bus_dir: str | Path | None, *, json: bool
) -> int:
    """Set the drives up, and no more; return the exit code."""
    sockets = _join(opened, scenario, bus, bus_dir)
    try:
        return set_up_drives(opened, sockets, json=json)
    except DriveError as error:
        raise _explained(error, bus, scenario) from None
    finally:
        for socket in sockets:
            socket.close()


def _explained(error: DriveError, bus: str, scenario: str | Path) -> DftcError:
    """Return the error of a set-up: where a drive does not answer, with what to look at."""
    if not isinstance(error.__cause__, SdoCommunicationError):
        return error  # a drive that answers is not what it should be
    return EnvironmentLacksError(str(error), _how_to_get_drives(bus, scenario))


def _listen(
    opened: Session,
    scenario: str | Path,
    bus: str,
    bus_dir: str | Path | None,
    seconds: float,
    *,
    ask: bool,
    json: bool,
) -> int:
    """Listen on the buses and print what is there; return the exit code."""
    sockets = _join(opened, scenario, bus, bus_dir, listen=True)
    try:
        print(f"listening on {bus} for {seconds:g} s", file=sys.stderr, flush=True)
        heard = listening.listen(opened, sockets, seconds, ask=ask)
    finally:
        for socket in sockets:
            socket.close()
    return show(heard, json=json)


def _join(
    opened: Session,
    scenario: str | Path,
    bus: str,
    bus_dir: str | Path | None,
    *,
    listen: bool = False,
) -> list[FrameSocket]:
    """Open every bus, to control or to listen.

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
                    f"no vcan interface {interface}", f"dftc bus up {scenario}, as root"
                )
    elif bus.startswith("socketcan:"):
        interfaces = _one_each(bus, bus.removeprefix("socketcan:"), names)
    elif bus.startswith("python-can:"):
        return _join_python_can(opened, bus, names)
    else:
        raise InputError("--bus", f"'{bus}'", _EXPECTED)
    fd = fd_bitrate(table) is not None
    sockets: list[FrameSocket] = []
    try:
        for name, interface in zip(names, interfaces, strict=True):
            sockets.append(
                StampedSocket(name, interface, fd=fd)
                if listen
                else SocketCanSocket(name, interface, fd=fd, errors=True)
            )
    except BusError as error:
        for socket in sockets:
            socket.close()
        remedy = f"dftc bus up {scenario}, as root"
        if bus != "vcan":
            kind = f"type can bitrate {table.bitrate}"
            kind += f" dbitrate {table.data_bitrate} fd on" if fd else ""
            remedy = (
                "ip -br link shows what there is; "
                f"ip link set NAME up {kind} restart-ms 100, as root"
            )
        raise EnvironmentLacksError(str(error), remedy) from None
    return sockets


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
    return (
        "check power, wiring, bit rate, and the node ids in robot.toml: "
        f"dftc control {scenario} --bus {bus} --listen"
    )
