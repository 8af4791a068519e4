"""Set-up of drives whose rig is in lock-step: what it sends belongs to no cycle.

A rig in lock-step keeps its answers until the controller ends the cycle. Set-up and shutdown
have no cycles and wait for answers, so the rig is told where cycles end for now. It cannot see
that by itself: what set-up sends a drive may come in a cycle as well, late or twice.

The rig answers behind everything sent before. So once set-up is over, none of its answers is
still on its way, to be taken for one of the first cycle.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from typing import Final

from dftc_rt.bus.barrier import OUTSIDE, BarrierSender, barrier_cycle, find_barrier
from dftc_rt.bus.frame import FRAME_SIZE, frame_buffer
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.bus.wait import Waiter
from dftc_rt.drives.interface import DriveSetup, SetUp
from dftc_rt.errors import BusError

_BATCH: Final = 64
_BEFORE_S: Final = 1.0  # a bus without a rig is set-up's to name
_BEHIND_S: Final = 10.0  # drives have answered: the rig is there, and may be held up


class OutsideCycles:
    """The set-up half of a profile, in lock-step; a ``DriveSetup``."""

    def __init__(
        self, setup: DriveSetup, sockets: Sequence[FrameSocket], frame_size: int = FRAME_SIZE
    ) -> None:
        """Wrap a set-up.

        Args:
            setup: The profile's.
            sockets: One a bus.
            frame_size: Bytes of a row of every buffer.
        """
        self._setup = setup
        self._sockets = list(sockets)
        self._sender = BarrierSender()
        self._inbox = frame_buffer(_BATCH, frame_size)
        self._number = OUTSIDE

    def configure(self) -> SetUp:
        """Bring every drive to the state from which the cycle can start.

        Raises:
            DriveError: A drive is missing, or is not what the robot file says.
            BusError: A bus has gone away, or its rig is not in lock-step.
        """
        self._leave(_BEFORE_S)
        found = self._setup.configure()
        silent = self._leave(_BEHIND_S)
        if silent is not None:
            raise BusError(silent.name, "nobody answers a barrier (is the rig in lock-step?)")
        return found

    def examine(self) -> tuple[str, ...]:
        """Read what the drives are; errors as of the profile's own."""
        self._leave(_BEFORE_S)
        return self._setup.examine()

    def shutdown(self) -> tuple[str, ...]:
        """Take power off every drive; return the joints whose drive did not confirm."""
        with contextlib.suppress(BusError):
            self._leave(_BEFORE_S)
        return self._setup.shutdown()

    def _leave(self, patience_s: float) -> FrameSocket | None:
        """Tell every bus that no cycle goes on, and forget what came before it knew.

        Returns:
            A bus that did not confirm within ``patience_s``; None: all did.

        Raises:
            BusError: A bus has gone away.
        """
        self._number += 1
        for socket in self._sockets:
            self._sender.send(socket, self._number)
        deadline = time.monotonic() + patience_s
        for socket in self._sockets:
            if not self._confirmed(socket, deadline):
                return socket
        return None

    def _confirmed(self, socket: FrameSocket, deadline: float) -> bool:
        """Receive until the barrier comes back; return whether it did in time."""
        inbox = self._inbox
        while True:
            count = socket.receive(inbox)
            at = find_barrier(inbox, count)
            while at < count:
                if barrier_cycle(inbox, at) == self._number:
                    return True
                at += 1 + find_barrier(inbox[at + 1 :], count - at - 1)
            left = deadline - time.monotonic()
            if not count and (socket.fd < 0 or left <= 0):
                return False
            if not count:
                Waiter([socket.fd]).wait(left)
