"""A SocketCAN node that only listens, with the time at which each frame came.

The loop does without time stamps: an answer belongs to the cycle in which it is read, and what
was left from before SYNC is never new. Here they tell how regular a frame is, and the time at
which this process got to read it would tell of the process instead.

Source: Linux ``Documentation/networking/timestamping.rst``.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator
from typing import Final

from dftc_rt.bus.frame import FD_FRAME_SIZE, FDF, FRAME_SIZE, Frames
from dftc_rt.bus.mmsg import gone
from dftc_rt.bus.socketcan import SocketCanSocket
from dftc_rt.errors import BusError

_SO_TIMESTAMPING: Final = 37  # the same number comes back as type of the control message
_RX_HARDWARE: Final = 1 << 2
_RX_SOFTWARE: Final = 1 << 3
_SOFTWARE: Final = 1 << 4
_RAW_HARDWARE: Final = 1 << 6
_STAMPS: Final = struct.Struct("@6l")  # software, unused, hardware: seconds and nanoseconds each


class StampedSocket(SocketCanSocket):
    """One raw socket that receives everything, its interface's error frames included."""

    __slots__ = ()

    def __init__(self, name: str, interface: str, *, fd: bool = False) -> None:
        """Bind to ``interface``, which must be up.

        Raises:
            EnvironmentLacksError: The kernel has no AF_CAN, or refuses it.
            BusError: As of ``SocketCanSocket``.
        """
        super().__init__(name, interface, fd=fd, errors=True)
        wanted = _RX_HARDWARE | _RAW_HARDWARE | _RX_SOFTWARE | _SOFTWARE
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPING, wanted)

    def receive_stamped(self, frames: Frames, stamps: list[float]) -> int:
        """Fill ``frames`` from row 0, and ``stamps`` with seconds; return how many came.

        A stamp is the adapter's own where it has one, else the kernel's; both count from some
        time of their own.

        Raises:
            BusError: The interface is down or gone.
        """
        stamps.clear()
        for row in range(len(frames)):
            try:
                size, control, _, _ = self._socket.recvmsg_into(
                    [memoryview(frames[row])], socket.CMSG_SPACE(_STAMPS.size)
                )
            except BlockingIOError:
                return row
            except OSError as error:
                raise BusError(self.name, f"{self.interface}: {gone(error.errno or 0)}") from error
            if frames.shape[1] == FD_FRAME_SIZE:
                frames[row, 5] = frames[row, 5] | FDF if size > FRAME_SIZE else 0
            stamps.append(next(_times(control), time.time()))
        return len(frames)


def _times(control: list[tuple[int, int, bytes]]) -> Iterator[float]:
    """Yield the time stamps of a message, s, the best first."""
    for level, kind, data in control:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPING and len(data) >= _STAMPS.size:
            seconds = _STAMPS.unpack_from(data)
            for at in (4, 0):
                if seconds[at] or seconds[at + 1]:
                    yield seconds[at] + 1e-9 * seconds[at + 1]
