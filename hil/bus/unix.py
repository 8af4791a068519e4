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
from hil.bus.paced_bus import PacedBus
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


class Listener:
    """Where nodes join a bus."""

    def __init__(self, name: str, listener: socket.socket) -> None:
        """Take over a listening socket (``listen``) of the bus ``name``."""
        listener.setblocking(False)
        self._name = name
        self._socket = listener
        self._newcomers = select.poll()
        self._newcomers.register(listener.fileno(), select.POLLIN)

    @property
    def fd(self) -> int:
        """Descriptor that becomes readable when a node waits; -1 once closed."""
        return self._socket.fileno()

    def admitted(self) -> list[UnixSocket]:
        """Return the bus's ends of the connections of nodes that have come since."""
        found: list[UnixSocket] = []
        while self._newcomers.poll(0):
            connection, _ = self._socket.accept()
            found.append(UnixSocket(self._name, connection))
        return found

    def close(self) -> None:
        """Let nobody join any more, and remove the socket file; a second call does nothing."""
        if self.fd < 0:
            return
        path = self._socket.getsockname()
        self._newcomers.unregister(self.fd)
        self._socket.close()
        Path(path).unlink(missing_ok=True)


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
        self._listener = Listener(name, listener)

    def fds(self) -> list[int]:
        """Return the descriptors to wait on: the listening one, then the clients'."""
        return [self._listener.fd, *super().fds()]

    def receive(self, frames: Frames) -> int:
        """Admit the nodes that wait, then receive. See ``BusPort.receive``."""
        for newcomer in self._listener.admitted():
            self.attach(newcomer)
        return super().receive(frames)

    def close(self) -> None:
        """Close the bus for every node and remove its socket file."""
        self._listener.close()
        super().close()


class PacedUnixPort(PacedBus):
    """The same with timing ``pace``: frames take their time on the wire; a ``BusPort``."""

    def __init__(
        self,
        name: str,
        listener: socket.socket,
        *,
        bitrate: int = 1_000_000,
        data_bitrate: int | None = None,
    ) -> None:
        """Take over a listening socket (``listen``).

        Args:
            name: Logical bus name.
            listener: AF_UNIX SOCK_SEQPACKET, listening.
            bitrate: Bits per second of the bus that is stood in for.
            data_bitrate: Of the data part of FD frames; None: a classical bus.
        """
        super().__init__(name, bitrate=bitrate, data_bitrate=data_bitrate)
        self._listener = Listener(name, listener)

    def fds(self) -> list[int]:
        """Return the descriptors to wait on: the listening one, then the clients'."""
        return [self._listener.fd, *super().fds()]

    def take_in(self) -> None:
        """Admit the nodes that wait, then take in. See ``BusPort.take_in``."""
        for newcomer in self._listener.admitted():
            self.attach(newcomer)
        super().take_in()

    def close(self) -> None:
        """Close the bus for every node and remove its socket file."""
        self._listener.close()
        super().close()
