"""The user-space virtual CAN bus: the rig listens on AF_UNIX, and is the bus."""

from __future__ import annotations

import os
import select
import socket
from pathlib import Path
from typing import Final

from dftc_rt.bus.directory import socket_path
from dftc_rt.bus.frame import Frames
from dftc_rt.bus.unix import UnixSocket
from dftc_rt.errors import EnvironmentLacksError
from hil.bus.virtual_bus import Timing, VirtualBus

_BACKLOG: Final = 64


def listen(directory: Path, name: str) -> socket.socket:
    """Open the listening socket of the bus ``name`` in a claimed directory.

    Raises:
        InputError: The name is no bus name, or the path too long.
        EnvironmentLacksError: The socket cannot be made there.
    """
    path = socket_path(directory, name)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        listener.bind(os.fspath(path))
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        raise EnvironmentLacksError(
            f"{path}: cannot open the bus ({error.strerror})",
            "name another directory with --bus-dir",
        ) from error
    return listener


class UnixPort(VirtualBus):
    """A virtual bus that nodes join through a socket file; a ``BusPort``.

    A node whose connection was made before another node's frames are received here
    sees those frames.
    """

    def __init__(
        self,
        name: str,
        listener: socket.socket,
        *,
        timing: Timing = "account",
        bitrate: int = 1_000_000,
        data_bitrate: int | None = None,
    ) -> None:
        """Take over a listening socket (``listen``).

        Args:
            name: Logical bus name.
            listener: AF_UNIX SOCK_SEQPACKET, listening.
            timing: ``off`` or ``account``.
            bitrate: Bits per second of the bus that is stood in for.
            data_bitrate: Of the data part of FD frames; None: a classical bus.
        """
        super().__init__(name, timing=timing, bitrate=bitrate, data_bitrate=data_bitrate)
        listener.setblocking(False)
        self._listener = listener
        self._newcomers = select.poll()
        self._newcomers.register(listener.fileno(), select.POLLIN)

    def fds(self) -> list[int]:
        """Return the descriptors to wait on: the listening one, then the clients'."""
        return [self._listener.fileno(), *super().fds()]

    def receive(self, frames: Frames) -> int:
        """Admit the nodes that wait, then receive. See ``BusPort.receive``."""
        if self._newcomers.poll(0):
            self._admit()
        return super().receive(frames)

    def close(self) -> None:
        """Close the bus for every node and remove its socket file."""
        if self._listener.fileno() < 0:
            return
        path = self._listener.getsockname()
        self._newcomers.unregister(self._listener.fileno())
        self._listener.close()
        Path(path).unlink(missing_ok=True)
        super().close()

    def _admit(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except BlockingIOError:
                return
            self.attach(UnixSocket(self.name, connection))
