"""What every bus looks like to the executor and to the rig."""

from __future__ import annotations

from typing import Protocol

from dftc_rt.bus.frame import Frames


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


def device_of(socket: FrameSocket) -> str:
    """Return what the system calls the interface of a bus; the bus's own name where it has none."""
    return str(getattr(socket, "interface", socket.name))
