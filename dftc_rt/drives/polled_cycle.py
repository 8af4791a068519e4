"""What the cycles of drives without SYNC have in common: each frame is answered, and no more.

What a cycle computes waits for the next tick and goes out with it, in place of SYNC; a drive
answers each frame. So a command acts one cycle after the measurement that it is made of.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames, frame_buffer
from dftc_rt.drives.interface import GOAL_OFF, DriveConfig
from dftc_rt.drives.membership import members_by_bus, missing, node_ids, node_lookup
from dftc_rt.drives.polled_scale import PolledScale
from dftc_rt.drives.scale import ScaleTable

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_CAPACITY: Final = 512  # rows of the largest batch that decode takes


class PolledCycle(ABC):
    """Feedback and commands of all drives of a robot; a profile's cycle adds its frames.

    Attributes:
        q: Joint positions, (n,), rad (m).
        v: Joint velocities, (n,), rad/s (m/s).
        torque_actual: Torque by the drive's own account, (n,), Nm (N): current times
            nominal torque constant, so it does not know of a loss.
        sent: Torques that go out at the next tick, (n,), Nm (N); 0 where none does.
        goal: One of ``GOAL_*``.
        seen: 1 when an answer came this cycle, (n,).
        status: CiA 402 statuswords that say the same as the drive's mode, (n,).
        emergency: 0: these protocols have none, (n,).
        other: Per row of the last decode: 0 feedback, 1 not ours, 3 without feedback.
    """

    def __init__(
        self,
        drives: Sequence[DriveConfig],
        scales: Sequence[PolledScale],
        buses: int,
        values: F64,
        seen: I64,
        status: I64,
        nodes: int,
    ) -> None:
        """Allocate what every profile needs.

        Args:
            drives: The drives, in joint order.
            scales: Theirs.
            buses: Number of buses.
            values: Rows position, velocity and torque of what answers say, (3, n).
            seen: The profile's row for it, (n,).
            status: The profile's row for it, (n,).
            nodes: One more than the largest node id of the profile.

        Raises:
            InputError: Two drives of a bus share a node id.
        """
        self.values = values
        self.q, self.v, self.torque_actual = values
        self.seen = seen
        self.status = status
        self.emergency = np.zeros(len(drives), dtype=np.int64)
        self.sent: F64 = np.zeros(len(drives))
        self.other = np.zeros(_CAPACITY, dtype=np.uint8)
        self.goal = GOAL_OFF
        self._scale = ScaleTable.of(scales).values
        self._host_id = scales[0].host_id
        self._node_ids = node_ids(drives)
        self._members = members_by_bus(drives, buses)
        self._lookups = [node_lookup(m, self._node_ids, nodes) for m in self._members]

    def _compile(self, frame_size: int) -> None:
        """Call every kernel on frames that change nothing."""
        out = frame_buffer(len(self.q), frame_size)
        self.command(np.zeros_like(self.q))
        for bus in range(len(self._members)):
            self.sync(bus, out)
            self.decode(bus, out, 0)
            self.missing(bus)

    def begin(self) -> None:
        """Begin a cycle: no answer has been seen yet."""
        self.seen[:] = 0

    @abstractmethod
    def sync(self, bus: int, out: Frames, row: int = 0) -> int:
        """Fill in, from ``row`` on, what the last cycle has for each drive of one bus."""

    @abstractmethod
    def decode(self, bus: int, frames: Frames, count: int) -> int:
        """Take in frames of one bus; return how many rows ``other`` marks."""

    def missing(self, bus: int) -> int:
        """Return how many joints of one bus have not answered in this cycle."""
        count: int = missing(self.seen, self._members[bus])
        return count

    @abstractmethod
    def command(self, tau: F64) -> None:
        """Limit and quantise the torques of all joints, (n,), Nm, for the next tick."""

    def encode(self, bus: int, out: Frames) -> int:
        """Send nothing: the commands go out at the next tick."""
        return 0
