"""What the rig sees of a bus, whatever carries it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames
from hil.bus.impairments import Impairments
from hil.bus.statistics import BusStatistics


class BusPort(Protocol):
    """The drives' end of one CAN bus.

    Attributes:
        name: Logical bus name (``can0``).
        fds_version: Grows whenever ``fds()`` would return something else.
        frame_size: Bytes of a row of every buffer: 16, or 72 on a bus that carries FD frames.
    """

    name: str
    fds_version: int
    frame_size: int

    def fds(self) -> list[int]:
        """Return the descriptors to wait on; empty for in-process links."""
        ...

    def receive(self, frames: Frames) -> int:
        """Fill ``frames`` with what the clients sent, in wire order; return how many.

        Passes them on to the other clients, admits clients that wait, and stops in
        front of a barrier: what a client sends behind one is held until ``pop_barrier``.
        Never blocks. When the buffer comes back full, more may wait that no descriptor
        tells of: call again.

        Raises:
            BusError: The bus itself has gone away (interface down); a client that
                leaves is no error.
        """
        ...

    def send(self, frames: Frames, count: int, nodes: NDArray[np.int32] | None = None) -> None:
        """Put the drives' first ``count`` frames on the bus, in wire order. Never blocks.

        Args:
            frames: uint8, shape ``(capacity, 16)``; left as it is.
            count: Rows to send.
            nodes: Sending node of each row, shape ``(>= count,)``: frames of one node
                keep their order. Without it, frames of equal identifier do.

        Raises:
            BusError: The bus itself has gone away.
        """
        ...

    def impair(self, impairments: Impairments) -> None:
        """Let faults of the bus act on its frames from now on."""
        ...

    def advance(self, t: float) -> None:
        """Let rig time move on to ``t``, s: faults come and go, late frames arrive."""
        ...

    @property
    def barrier_pending(self) -> bool:
        """Whether some client has ended its share of the cycle."""
        ...

    @property
    def barrier_cycle(self) -> int | None:
        """Cycle of the barrier that ``pop_barrier`` would return; None: no barrier waits."""
        ...

    def pop_barrier(self) -> int | None:
        """Return the cycle of the barrier that waits, and let its client go on; or None."""
        ...

    def send_barrier(self, cycle: int) -> None:
        """Answer the client whose barrier was popped last, behind everything sent before.

        Raises:
            RuntimeError: No barrier has been popped since the last answer.
        """
        ...

    def count_into(self, totals: NDArray[np.int64]) -> None:
        """Keep the counts of frames and bits there from now on, for another process to read.

        Args:
            totals: Shape ``(7,)``, the columns of :mod:`hil.bus.statistics`; written in place.
        """
        ...

    @property
    def statistics(self) -> BusStatistics:
        """What has gone over the bus since it was opened."""
        ...

    def close(self) -> None:
        """Close the bus for every node; a second call does nothing."""
        ...
