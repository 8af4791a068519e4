"""Any python-can interface (pcan, kvaser, slcan, …) as a ``FrameSocket``.

Slower than a socket of our own, a Python object a frame; for adapters that have no
SocketCAN driver.
"""

from __future__ import annotations

import can

from dftc_rt.bus.frame import Frames
from dftc_rt.bus.python_can import to_frame, to_message
from dftc_rt.errors import BusError, EnvironmentLacksError


class PythonCanSocket:
    """One python-can bus; a ``FrameSocket``.

    Error frames are left out.

    Attributes:
        name: Logical bus name.
        fd: Descriptor that becomes readable when a frame waits; -1 when the interface
            has none, and then it has to be asked again and again.
    """

    __slots__ = ("_bus", "_closed", "fd", "name")

    def __init__(self, name: str, bus: can.BusABC) -> None:
        """Take over an open python-can bus."""
        self.name = name
        self._bus = bus
        self._closed = False
        try:
            self.fd = bus.fileno()
        except NotImplementedError:
            self.fd = -1

    def send(self, frames: Frames, count: int) -> int:
        """Send the first ``count`` rows; return how many were accepted.

        Raises:
            BusError: The bus has gone away.
        """
        if self._closed:
            raise BusError(self.name, "the bus has gone away (closed)")
        for row in range(count):
            try:
                self._bus.send(to_message(frames, row, self.name, 0.0), timeout=0.0)
            except can.CanTimeoutError:
                return row
            except (can.CanError, OSError) as error:
                raise BusError(self.name, str(error)) from error
        return count

    def receive(self, frames: Frames) -> int:
        """Fill ``frames`` from row 0; return how many frames came.

        Raises:
            BusError: The bus has gone away.
        """
        if self._closed:
            raise BusError(self.name, "the bus has gone away (closed)")
        count = 0
        while count < len(frames):
            try:
                message = self._bus.recv(timeout=0.0)
            except (can.CanError, OSError) as error:
                raise BusError(self.name, str(error)) from error
            if message is None:
                break
            if message.is_error_frame or message.is_fd:
                continue
            to_frame(message, frames, count)
            count += 1
        return count

    def close(self) -> None:
        """Close the bus; a second call does nothing."""
        if not self._closed:
            self._closed = True
            self.fd = -1
            self._bus.shutdown()


def open_python_can(name: str, interface: str, channel: str, bitrate: int) -> PythonCanSocket:
    """Open a bus through python-can.

    Args:
        name: Logical bus name.
        interface: python-can interface (``pcan``).
        channel: Channel, as that interface names it.
        bitrate: Bits per second.

    Raises:
        EnvironmentLacksError: python-can does not know the interface, or lacks its driver.
        BusError: The bus cannot be opened.
    """
    try:
        bus = can.Bus(channel=channel, interface=interface, bitrate=bitrate)
    except (can.CanInterfaceNotImplementedError, ImportError, NameError) as error:
        raise EnvironmentLacksError(
            f"python-can has no interface {interface} here ({error})",
            "install its driver; 'python -m can.viewer --help' lists the interfaces",
        ) from error
    except (can.CanError, OSError, ValueError) as error:
        raise BusError(name, f"cannot open {interface} {channel} ({error})") from error
    return PythonCanSocket(name, bus)
