"""Any python-can interface (pcan, kvaser, slcan, …) as a ``FrameSocket``.

Slower than a socket of our own, a Python object a frame; for adapters that have no
SocketCAN driver.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections import deque
from typing import Any, Final

import can
import numpy as np

from dftc_rt.bus.error_frames import BUS_ERROR
from dftc_rt.bus.frame import ERR_FLAG, FD_FRAME_SIZE, Frames, pack
from dftc_rt.bus.python_can import to_frame, to_message
from dftc_rt.errors import BusError, EnvironmentLacksError

_A_BUS_ERROR: Final = np.frombuffer(
    pack(ERR_FLAG | BUS_ERROR, bytes(8)).ljust(FD_FRAME_SIZE, b"\0"), dtype=np.uint8
)
_LISTEN_S: Final = 0.05  # that the reading thread may notice late that the bus is closed


class PythonCanSocket:
    """One python-can bus; a ``FrameSocket``.

    Error frames come as those of one class, BUS_ERROR: what else they say differs between
    interfaces. FD frames are left out where a buffer has rows for classical ones. An
    interface without a descriptor to wait on is read by a thread, which hands its messages over
    in order.

    Attributes:
        name: Logical bus name.
        fd: Descriptor that becomes readable when a frame waits; -1 once closed.
    """

    __slots__ = ("_bus", "_reader", "fd", "name")

    def __init__(self, name: str, bus: can.BusABC) -> None:
        """Take over an open python-can bus."""
        self.name = name
        self._bus = bus
        self._reader: _Reader | None = None
        self.fd = _descriptor(bus)
        if self.fd < 0:
            self._reader = _Reader(bus)
            self.fd = self._reader.fd

    def send(self, frames: Frames, count: int) -> int:
        """Send the first ``count`` rows; return how many were accepted.

        Raises:
            BusError: The bus has gone away.
        """
        if self.fd < 0:
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
        if self.fd < 0:
            raise BusError(self.name, "the bus has gone away (closed)")
        count = 0
        wide = frames.shape[1] == FD_FRAME_SIZE
        try:
            while count < len(frames):
                message = (self._reader or self._bus).recv(0.0)
                if message is None:
                    break
                if message.is_error_frame:
                    frames[count] = _A_BUS_ERROR[: frames.shape[1]]
                    count += 1
                elif wide or not message.is_fd:
                    to_frame(message, frames, count)
                    count += 1
        except (can.CanError, OSError) as error:
            raise BusError(self.name, str(error)) from error
        return count

    def close(self) -> None:
        """Close the bus; a second call does nothing."""
        if self.fd >= 0:
            self.fd = -1
            if self._reader is not None:
                self._reader.close()
            self._bus.shutdown()


class _Reader:
    """Reads a bus that has nothing to wait on, and makes a descriptor readable.

    Attributes:
        fd: Readable while a message, or the error that ended the reading, waits.
    """

    def __init__(self, bus: can.BusABC) -> None:
        """Start reading."""
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._bus = bus
        self._messages: deque[can.Message] = deque()
        self._error: Exception | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._read, name="python-can reader", daemon=True)
        self._thread.start()

    def recv(self, timeout: float) -> can.Message | None:
        """Return the next message, or None.

        Args:
            timeout: 0: never waits.

        Raises:
            CanError: Reading has failed.
            OSError: The same.
        """
        if not self._messages:
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(self.fd)  # first, so that a message that comes now sets it again
            if not self._messages:
                if self._error is not None:
                    raise self._error
                return None
        return self._messages.popleft()

    def close(self) -> None:
        """Stop reading."""
        self._ended = True
        self._thread.join()
        os.close(self.fd)

    def _read(self) -> None:
        while not self._ended:
            try:
                message = self._bus.recv(_LISTEN_S)
            except (can.CanError, OSError) as error:
                self._error = error
                os.eventfd_write(self.fd, 1)
                return
            if message is not None:
                self._messages.append(message)
                os.eventfd_write(self.fd, 1)


def _descriptor(bus: can.BusABC) -> int:
    """Return the descriptor of a bus to wait on, -1 when it has none."""
    try:
        return int(bus.fileno())
    except (NotImplementedError, can.CanOperationError):
        return -1


def open_python_can(
    name: str, interface: str, channel: str, bitrate: int, data_bitrate: int | None = None
) -> PythonCanSocket:
    """Open a bus through python-can.

    Args:
        name: Logical bus name.
        interface: python-can interface (``pcan``).
        channel: Channel, as that interface names it.
        bitrate: Bits per second.
        data_bitrate: Of the data part of FD frames; None: a classical bus.

    Raises:
        EnvironmentLacksError: python-can does not know the interface, or lacks its driver.
        BusError: The bus cannot be opened.
    """
    options: dict[str, Any] = (
        {} if data_bitrate is None else {"fd": True, "data_bitrate": data_bitrate}
    )
    try:
        bus = can.Bus(channel=channel, interface=interface, bitrate=bitrate, **options)
    except (can.CanInterfaceNotImplementedError, ImportError, NameError) as error:
        raise EnvironmentLacksError(
            f"python-can has no interface {interface} here ({error})",
            "install its driver; 'python -m can.viewer --help' lists the interfaces",
        ) from error
    except (can.CanError, OSError, ValueError, TypeError) as error:
        raise BusError(name, f"cannot open {interface} {channel} ({error})") from error
    return PythonCanSocket(name, bus)
