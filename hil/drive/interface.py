"""What the rig needs of the drives that it emulates, whatever protocol they speak."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames

I64 = NDArray[np.int64]


class EmulatedDrives(Protocol):
    """All drives of a rig, on all its buses; time is the rig's.

    Attributes:
        objects: What the drives know, (n, N_OBJECTS), int64, columns of
            :mod:`hil.drive.slots`. The rig writes POSITION, VELOCITY and TORQUE_ACTUAL, and
            reads COMMAND and ENABLED; counts are those of the drives' ``ScaleTable``.
        operation_enabled: View: 1 while a drive follows torque commands, (n,).
        commands: View: torque commands taken so far, (n,).
        senders: Drive of each row of the last answer, (>= rows,), int32.
        synced: Whether the last :meth:`receive` took what starts a cycle: SYNC, or where
            there is none a torque command. Its answers are of the state at the step's end.
        switched: Whether it took what puts a drive into another mode where there is no SYNC.
            Outside of cycles that is answered at once; in them it starts one, too.
    """

    objects: I64
    operation_enabled: I64
    commands: I64
    senders: NDArray[np.int32]
    synced: bool
    switched: bool

    def tick(self, t: float) -> None:
        """Let rig time move on to ``t``, s: timers and watchdogs."""
        ...

    def receive(self, bus: int, frames: Frames, start: int, count: int) -> int:
        """Take frames of one bus from row ``start`` on; return the row after the last taken.

        That is ``count``, or earlier where the rig is to look at ``synced`` first.
        """
        ...

    def answer(self, bus: int, out: Frames) -> int:
        """Fill in what the drives of one bus send now; return how many rows."""
        ...
