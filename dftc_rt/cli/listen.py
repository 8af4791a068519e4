"""``dftc control --listen``: what is on the buses, before anything is enabled.

Nothing is sent; with ``--ask`` questions, which change nothing either.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from dftc_rt.bus.budget import WORST_CASE_LIMIT, BusLoad
from dftc_rt.bus.can_link import CanLink, decode_can_link
from dftc_rt.bus.census import Census
from dftc_rt.bus.frame import Frames, frame_buffer
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.bus.link_kind import link_of
from dftc_rt.bus.rtnetlink import Link
from dftc_rt.bus.stamped import StampedSocket
from dftc_rt.bus.wait import Waiter
from dftc_rt.cli.session import Session
from dftc_rt.config.scenario import BusTable
from dftc_rt.controller import bus_loads
from dftc_rt.drives.interface import DriveConfig, DriveCycle, SetUp, profile
from dftc_rt.drives.roles import Role, role_of
from dftc_rt.drives.wiring import fd_bitrate, frame_size, robot_drives
from dftc_rt.errors import BusError

_CAPACITY: Final = 256
_ASK_S: Final = 0.2  # a drive that is there answers at once


@dataclass
class HeardBus:
    """One bus as it was heard.

    Attributes:
        socket: Where frames come from.
        joints: Node id -> joint, of this bus.
        load: What our traffic would take.
        census: What came.
        link: Its interface; None when it is no network link.
        can: How its driver says that it is set up; None without a link.
        roles: What each identifier that came is.
        lost: Why it went away; "" when it did not.
    """

    socket: FrameSocket
    joints: dict[int, str]
    load: BusLoad
    census: Census
    link: Link | None = None
    can: CanLink | None = None
    roles: dict[int, Role] = field(default_factory=dict)
    lost: str = ""

    @property
    def name(self) -> str:
        """Logical bus name."""
        return self.socket.name

    def spoken(self, speaker: str) -> list[str]:
        """Return what somebody said, in words or by identifier, each once."""
        texts = [
            role.what or self.census.seen[can_id].name
            for can_id, role in self.roles.items()
            if role.speaker == speaker
        ]
        return list(dict.fromkeys(texts))


@dataclass
class Heard:
    """What listening found.

    Attributes:
        seconds: How long it took.
        buses: The buses.
        drives: The robot's drives, in joint order.
        cycle: What the frames of the drives said.
        present: Whether each drive said something.
        asked: What is wrong with each drive by its own account; empty when none was asked.
        against: What stands against a start, in lines.
    """

    seconds: float
    buses: list[HeardBus]
    drives: list[DriveConfig]
    cycle: DriveCycle
    present: list[bool]
    asked: tuple[str, ...] = ()
    against: list[str] = field(default_factory=list)

    def name_of(self, drive: DriveConfig) -> str:
        """Return a drive's name for people."""
        where = self.buses[drive.bus].name
        return f"{drive.scale.joint} (node {drive.node_id} on {where})"


def listen(opened: Session, sockets: Sequence[FrameSocket], seconds: float, *, ask: bool) -> Heard:
    """Listen on all buses.

    Args:
        opened: The session.
        sockets: One a bus, in the order of ``bus_names``.
        seconds: How long.
        ask: Then ask every drive what it is, unless somebody else talks to the drives.

    Raises:
        InputError: The profile has nothing to ask with.
        EnvironmentLacksError: The kernel does not say what an interface is.
        BusError: A bus has gone away while the drives were asked.
    """
    table, rate_hz = opened.scenario.bus, opened.scenario.executor.rate_hz
    drives = robot_drives(opened.robot, table)
    loads = bus_loads(opened.scenario, opened.robot)
    buses = [_bus(table, k, s, loads[k], drives) for k, s in enumerate(sockets)]
    cycle = profile(table.profile).cycle(drives, len(buses), rate_hz)
    nothing = np.zeros(len(drives), dtype=np.int64)
    cycle.start(SetUp(nothing, nothing))
    cycle.begin()  # and never again: ``seen`` adds up
    seconds = _hear(buses, cycle, seconds, frame_size(table))
    for bus in buses:
        bus.roles = {i: role_of(table, i, bus.joints) for i in bus.census.seen}
    speakers = {role.joint for bus in buses for role in bus.roles.values()}
    present = [
        bool(seen) or drive.scale.joint in speakers
        for drive, seen in zip(drives, cycle.seen, strict=True)
    ]
    heard = Heard(seconds, buses, drives, cycle, present)
    if ask and not any(bus.spoken("controller") or bus.lost for bus in buses):
        heard.asked = profile(table.profile).setup(sockets, drives, rate_hz, _ASK_S).examine()
        heard.present = [was or not wrong for was, wrong in zip(present, heard.asked, strict=True)]
    heard.against = _against(heard, table)
    if ask and not heard.asked:
        heard.against.append("no drive was asked, for that")
    return heard


def _bus(
    table: BusTable, k: int, socket: FrameSocket, load: BusLoad, drives: Sequence[DriveConfig]
) -> HeardBus:
    link = link_of(socket.interface) if isinstance(socket, StampedSocket) else None
    return HeardBus(
        socket,
        {drive.node_id: drive.scale.joint for drive in drives if drive.bus == k},
        load,
        Census(table.bitrate, fd_bitrate(table)),
        link,
        None if link is None else decode_can_link(link.data),
    )


def _hear(buses: Sequence[HeardBus], cycle: DriveCycle, seconds: float, size: int) -> float:
    """Receive for so long, or until the last bus has gone away; return how long it was, s."""
    frames, stamps = frame_buffer(_CAPACITY, size), list[float]()
    began = time.monotonic()
    there = list(enumerate(buses))
    waiter = Waiter([bus.socket.fd for bus in buses])
    while there and (left := began + seconds - time.monotonic()) > 0.0:
        waiter.wait(left)
        for k, bus in tuple(there):
            try:
                count = _receive(bus.socket, frames, stamps)
            except BusError as error:
                bus.lost = error.what
                there.remove((k, bus))
                waiter = Waiter([other.socket.fd for _, other in there])
                continue
            bus.census.take(frames, count, stamps)
            cycle.decode(k, frames, count)
    return time.monotonic() - began


def _receive(socket: FrameSocket, frames: Frames, stamps: list[float]) -> int:
    """Receive with time stamps: the adapter's or the kernel's, else the time of reading."""
    if isinstance(socket, StampedSocket):
        return socket.receive_stamped(frames, stamps)
    count = socket.receive(frames)
    stamps[:] = [time.monotonic()] * count
    return count


def _against(heard: Heard, table: BusTable) -> list[str]:
    """Return what stands against a start."""
    found = [
        f"{heard.name_of(drive)}: not heard"
        for k, drive in enumerate(heard.drives)
        if not heard.present[k] and not heard.asked
    ]
    found += [
        f"{heard.name_of(drive)}: {wrong}"
        for drive, wrong in zip(heard.drives, heard.asked, strict=False)
        if wrong
    ]
    missing = {drive.node_id: drive for k, drive in enumerate(heard.drives) if not heard.present[k]}
    for k, bus in enumerate(heard.buses):
        lines = _set_up_wrong(bus, table)
        if bus.lost:
            lines.append(bus.lost)
        if said := bus.spoken("controller"):
            lines.append(f"somebody else talks to these drives: {', '.join(said)}")
        if bus.census.errors.state in ("passive", "bus-off"):
            lines.append(f"the interface is error {bus.census.errors.state}")
        foreign = sum(
            seen.bit_s
            for can_id, seen in bus.census.seen.items()
            if bus.roles[can_id].speaker == "unknown"
        )
        share = foreign / max(heard.seconds, 1e-9)
        if bus.load.worst + share > WORST_CASE_LIMIT:
            lines.append(
                f"other nodes take {share:.0%} of the wire, ours up to {bus.load.worst:.0%}: "
                f"more than {WORST_CASE_LIMIT:.0%}"
            )
        for node in sorted({role.node for role in bus.roles.values()} & missing.keys()):
            drive = missing[node]
            if drive.bus != k:
                lines.append(
                    f"node {node} is here; {drive.scale.joint} should be on "
                    f"{heard.buses[drive.bus].name}"
                )
        found += [f"{bus.name}: {line}" for line in lines]
    return found


def _set_up_wrong(bus: HeardBus, table: BusTable) -> list[str]:
    """Return what is wrong with how an interface is set up, by its driver's account."""
    can, lines = bus.can, list[str]()
    if can is None:
        return lines
    if can.bitrate and can.bitrate != table.bitrate:
        lines.append(f"set to {can.bitrate} bit/s, the scenario says {table.bitrate}")
    wanted = fd_bitrate(table)
    if wanted and can.bitrate and can.data_bitrate != wanted:
        lines.append(f"data of CAN FD set to {can.data_bitrate} bit/s, the scenario says {wanted}")
    if can.state not in ("", "error active", "error warning"):
        lines.append(f"the interface is {can.state}")
    if "listen-only" in can.modes:
        lines.append("the interface is set to listen-only")
    return lines
