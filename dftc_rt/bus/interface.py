"""What every bus looks like to the executor and to the rig."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from dftc_rt.bus.frame import Frames

Filters = Sequence[tuple[int, int]]
"""Acceptance filters: (identifier, mask) pairs, flags included (:mod:`dftc_rt.bus.filters`)."""


class FrameSocket(Protocol):
    """One node's connection to one CAN bus.

    Attributes:
        name: Logical bus name (``can0``).
        fd: Descriptor that becomes readable when a frame waits; -1 for the
            in-process link, which never has to be waited for.
    """

    name: str
    fd: int

    def send(self, frames: Frames, count: int) -> int:
        """Send the first ``count`` rows; return how many were accepted. Never blocks.

        Raises:
            BusError: The bus has gone away (peer closed, interface down).
        """
        ...

    def receive(self, frames: Frames) -> int:
        """Fill ``frames`` from row 0; return how many frames came. Never blocks.

        Raises:
            BusError: The bus has gone away.
        """
        ...

    def close(self) -> None:
        """Close the connection; a second call does nothing."""
        ...


class FilteringSocket(FrameSocket, Protocol):
    """A connection that can be told what not to receive."""

    def set_filters(self, filters: Filters | None) -> None:
        """Receive only frames that one of ``filters`` takes; None: all. For set-up.

        What is on its way already comes still.

        Raises:
            InputError: There are too many.
            BusError: The bus has gone away, or does not read.
        """
        ...


def device_of(socket: FrameSocket) -> str:
    """Return what the system calls the interface of a bus; the bus's own name where it has none."""
    return str(getattr(socket, "interface", socket.name))
