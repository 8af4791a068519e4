"""Both ends of a run's buses, for each way of carrying them."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dftc_rt.bus import unix
from dftc_rt.bus.directory import BusDirectory
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.bus.select import BusChoice, choose_bus
from dftc_rt.bus.socketcan import SocketCanSocket
from dftc_rt.bus.vcan_links import check_fd
from dftc_rt.cli.session import Session
from dftc_rt.config.scenario import BusTable
from dftc_rt.drives.wiring import bus_names, fd_bitrate
from dftc_rt.errors import InputError
from hil.bus.port import BusPort
from hil.bus.socketcan import SocketCanPort
from hil.bus.unix import PacedUnixPort, UnixPort, listen
from hil.bus.virtual_bus import unpaced
from hil.rig import EventFunction, RecordSink, Rig, initial_state


def choose(opened: Session, bus: str | None, *, lockstep: bool) -> BusChoice:
    """Choose how the rig's buses are carried.

    Args:
        opened: The session.
        bus: The option ``--bus``; None: as in the scenario.
        lockstep: Whether rig time moves by barriers only.

    Raises:
        InputError: There is no such way, or ``bus.timing = "pace"`` does not go with it.
        EnvironmentLacksError: The machine lacks what was asked for.
    """
    table = opened.scenario.bus
    wanted = table.interface if bus is None else bus
    names = bus_names(opened.robot.joint_config)
    if table.timing != "pace":
        return choose_bus(wanted, names)
    if lockstep:
        unpaced(table.timing)
    if wanted == "auto":
        return BusChoice("unix", "user-space bus, which alone keeps the time of frames (pace)")
    choice = choose_bus(wanted, names)
    if choice.kind != "unix":
        raise InputError("bus.timing", f"'pace' on {wanted}", "unix: the user-space bus in time")
    return choice


@dataclass
class RigBuses:
    """The rig's end: made before the processes, so that the controller can join at once.

    Attributes:
        names: Logical bus names.
        table: The scenario's ``[bus]``.
        choice: How frames are carried.
        directory: Where the user-space buses live; None for vcan.
    """

    names: Sequence[str]
    table: BusTable
    choice: BusChoice
    directory: BusDirectory | None = None
    _made: bool = False  # the directory was not there before
    _listeners: dict[str, socket.socket] = field(default_factory=dict)

    def open(self, path: Path) -> None:
        """Claim the directory and listen on every bus; for vcan, look whether it will do.

        Raises:
            InputError: The directory is in use or unsafe.
            EnvironmentLacksError: It cannot be made, or a vcan link carries no CAN FD.
        """
        if self.choice.kind == "unix":
            self._made = not os.path.lexists(path)
            self.directory = BusDirectory(path)
            for name in self.names:
                self._listeners[name] = listen(path, name)
        elif self.choice.kind == "vcan" and fd_bitrate(self.table) is not None:
            remedy = "dftc bus up SCENARIO, with the same --set, as root; or --bus unix"
            check_fd(list(self.choice.interfaces.values()), remedy)

    def ports(self) -> list[BusPort]:
        """Return the rig's ports; to be called in the rig's process.

        Raises:
            BusError: An interface is gone.
        """
        table = self.table
        if self.choice.kind == "unix":
            return [self._unix_port(name, table) for name in self.names]
        return [
            SocketCanPort(
                n,
                self.choice.interfaces[n],
                timing=unpaced(table.timing),
                bitrate=table.bitrate,
                data_bitrate=fd_bitrate(table),
            )
            for n in self.names
        ]

    def _unix_port(self, name: str, table: BusTable) -> BusPort:
        listener, bitrate, data = self._listeners[name], table.bitrate, fd_bitrate(table)
        if table.timing == "pace":
            return PacedUnixPort(name, listener, bitrate=bitrate, data_bitrate=data)
        return UnixPort(
            name, listener, timing=table.timing, bitrate=bitrate, data_bitrate=data
        )  # fmt: skip

    def let_go(self) -> None:
        """Close the listeners of a process that is not the rig."""
        for listener in self._listeners.values():
            listener.close()
        self._listeners.clear()

    def release(self) -> None:
        """Give the directory back and remove what is in it, and itself where it was made here."""
        self.let_go()
        if self.directory is not None:
            self.directory.release()
            if self._made:
                with contextlib.suppress(OSError):  # another rig has taken it by now
                    self.directory.path.rmdir()


def make_rig(
    opened: Session, ports: Sequence[BusPort], sink: RecordSink, event: EventFunction
) -> Rig:
    """Build the rig of a session.

    Raises:
        InputError: A value of ``[rig]`` or a fault does not fit the robot.
    """
    motion = np.empty((3, opened.robot.n))
    opened.parts.reference.target(0.0, motion)
    q0, v0 = initial_state(opened.scenario, opened.robot, motion)
    return Rig(opened.scenario, opened.robot, ports, q0, v0, sink, event)


def join(
    names: Sequence[str], choice: BusChoice, directory: Path | None, fd: bool
) -> list[FrameSocket]:
    """Open the controller's end of every bus.

    Args:
        names: Logical bus names.
        choice: How frames are carried.
        directory: Where the user-space buses live; None for vcan.
        fd: Whether frames are CAN FD.

    Raises:
        BusError: A bus is not there.
    """
    if choice.kind == "vcan":
        return [
            SocketCanSocket(name, choice.interfaces[name], fd=fd, errors=True) for name in names
        ]
    if directory is None:
        raise ValueError("the user-space bus needs a directory")
    return [unix.connect(name, directory) for name in names]
