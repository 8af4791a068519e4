"""What the executor needs of a drive profile, and the profiles there are.

A profile has two halves: set-up, which may raise, wait and allocate, and the cycle, which
may not. Both see joints by their index over the whole robot and buses by theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames
from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

GOAL_OFF: Final = 0  # no torque, brakes closed
GOAL_READY: Final = 1  # powered, no torque
GOAL_OPERATE: Final = 2  # follow the torque commands
GOAL_STOP: Final = 3  # stop as fast as the drive can by itself, then off


@dataclass(frozen=True, slots=True)
class DriveConfig:
    """One drive as the robot file describes it.

    Attributes:
        node_id: Node id on its bus.
        bus: Index of its bus.
        scale: Its units; carries the joint's name.
    """

    node_id: int
    bus: int
    scale: JointScale


@dataclass(frozen=True, slots=True)
class SetUp:
    """What set-up found out, for the cycle to start from.

    Attributes:
        statusword: Last status of each drive, (n,).
        counts: Position of each drive, (n,), counts.
    """

    statusword: I64
    counts: I64


class DriveSetup(Protocol):
    """Set-up half: raises, waits, allocates; no threads are left when it returns."""

    def configure(self) -> SetUp:
        """Bring every drive to the state from which the cycle can start.

        Raises:
            DriveError: A drive is missing, or is not what the robot file says.
            BusError: A bus has gone away.
        """
        ...

    def examine(self) -> tuple[str, ...]:
        """Ask every drive what it is; what is sent changes nothing.

        Returns:
            What is wrong with each drive, (n,); "" with one that is what the robot file says.

        Raises:
            InputError: The protocol has no question that is not a command as well.
            BusError: A bus has gone away.
        """
        ...

    def shutdown(self) -> tuple[str, ...]:
        """Take power off every drive; return the joints whose drive did not confirm."""
        ...


class DriveCycle(Protocol):
    """Cycle half: real-time safe, no I/O; one object for all buses.

    Attributes:
        q: Joint positions, (n,), rad (m).
        v: Joint velocities, (n,), rad/s (m/s).
        sent: Torques as sent, after limit and quantisation, (n,), Nm (N).
        seen: Bit 0 is set when position and velocity came in this cycle, (n,).
        status: CiA 402 statuswords, whatever the profile calls its states, (n,).
        emergency: Last emergency error code of each drive, (n,); 0 where a profile has none.
        other: Per row of the last decode: 0 feedback, 1 not ours, 2 emergency, 3 short.
        goal: One of ``GOAL_*``.
    """

    q: F64
    v: F64
    sent: F64
    seen: I64
    status: I64
    emergency: I64
    other: NDArray[np.uint8]
    goal: int

    def start(self, found: SetUp) -> None:
        """Begin from what set-up found."""
        ...

    def begin(self) -> None:
        """Begin a cycle: no answer has been seen yet."""
        ...

    def sync(self, bus: int, out: Frames, row: int = 0) -> int:
        """Fill in, from ``row`` on, what is sent at the tick; return the row after it."""
        ...

    def decode(self, bus: int, frames: Frames, count: int) -> int:
        """Take in frames of one bus; return how many were not cyclic feedback."""
        ...

    def missing(self, bus: int) -> int:
        """Return how many joints of one bus have not answered in this cycle."""
        ...

    def command(self, tau: F64) -> None:
        """Set the torques of all joints, (n,), Nm; ``sent`` holds what becomes of them."""
        ...

    def encode(self, bus: int, out: Frames) -> int:
        """Fill in the commands of one bus; return how many rows."""
        ...


@dataclass(frozen=True, slots=True)
class Profile:
    """One way of talking to drives.

    Attributes:
        name: As in ``[bus] profile``.
        setup: (sockets, drives, rate_hz, timeout_s=1.0) -> set-up half.
        cycle: (drives, number of buses, rate_hz) -> cycle half.
        fd: Whether its frames are CAN FD: all buffers then have rows of 72 bytes.
    """

    name: str
    setup: Callable[..., DriveSetup]
    cycle: Callable[[Sequence[DriveConfig], int, float], DriveCycle]
    fd: bool = False


PROFILES: Final = {
    "cia402": "dftc_rt.drives.cia402.profile",
    "mit": "dftc_rt.drives.mit.profile",
    "moteus": "dftc_rt.drives.moteus.profile",
}
"""Name -> module that holds its ``PROFILE``."""


def profile(name: str) -> Profile:
    """Return a profile by name.

    Raises:
        InputError: There is no such profile.
    """
    if name not in PROFILES:
        raise InputError("bus.profile", repr(name), " or ".join(PROFILES))
    found = import_module(PROFILES[name]).PROFILE
    assert isinstance(found, Profile)
    return found
