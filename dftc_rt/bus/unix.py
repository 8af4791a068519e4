"""A node on the user-space virtual CAN bus: AF_UNIX, SOCK_SEQPACKET, one record a frame."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path
from typing import Final

from dftc_rt.bus.directory import socket_path
from dftc_rt.bus.filters import send_filters
from dftc_rt.bus.frame import Frames
from dftc_rt.bus.interface import Filters
from dftc_rt.bus.mmsg import FrameBatcher
from dftc_rt.errors import BusError

BUFFER_BYTES: Final = 1 << 20  # asked for; the kernel caps it (net.core.wmem_max)


class UnixSocket:
    """One end of a connection to the user-space bus; a ``FrameSocket``.

    Attributes:
        name: Logical bus name.
        fd: Descriptor that becomes readable when a frame waits; -1 once closed.
    """

    __slots__ = ("_batcher", "_socket", "fd", "name")

    def __init__(self, name: str, connection: socket.socket) -> None:
        """Take over a connected SOCK_SEQPACKET socket."""
        connection.setblocking(False)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
        self.name = name
        self.fd = connection.fileno()
        self._socket = connection
        self._batcher = FrameBatcher(name)

    def send(self, frames: Frames, count: int) -> int:
        """Send the first ``count`` rows; return how many were accepted. Never blocks.

        Raises:
            BusError: The other end is closed, or this one.
        """
        return self._batcher.send(self.fd, frames, count)

    def receive(self, frames: Frames) -> int:
        """Fill ``frames`` from row 0; return how many frames came. Never blocks.

        Raises:
            BusError: The other end is closed and nothing is left to read, or this one.
        """
        return self._batcher.receive(self.fd, frames)

    def set_filters(self, filters: Filters | None) -> None:
        """Have the bus forward only frames that one of ``filters`` takes; None: all. For set-up.

        What the bus has sent before comes still.

        Raises:
            InputError: There are too many.
            BusError: The bus has gone away, or does not read.
        """
        send_filters(self, filters)

    def close(self) -> None:
        """Leave the bus."""
        self.fd = -1
        self._socket.close()


def connect(name: str, directory: Path) -> UnixSocket:
    """Join the bus ``name`` that a rig has opened in ``directory``.

    Raises:
        BusError: No rig has such a bus open.
        InputError: The name cannot be a bus name, or the path is too long for a socket.
    """
    path = socket_path(directory, name)
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        connection.connect(os.fspath(path))
    except OSError as error:
        with contextlib.suppress(OSError):
            connection.close()
        raise BusError(name, f"no rig has this bus open at {path} ({error.strerror})") from error
    return UnixSocket(name, connection)
