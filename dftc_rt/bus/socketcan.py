"""A node on a SocketCAN interface: AF_CAN, raw.

This opens whatever interface it is told, a live one included; that is for
``dftc control`` with the interface spelled out. The rig asks for vcan first.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import struct
from typing import Final

from dftc_rt.bus.error_frames import ALL_CLASSES
from dftc_rt.bus.filters import check_filters
from dftc_rt.bus.frame import ERR_FLAG, FD_FRAME_SIZE, Frames
from dftc_rt.bus.interface import Filters
from dftc_rt.bus.mmsg import FrameBatcher
from dftc_rt.errors import BusError, EnvironmentLacksError

BUFFER_BYTES: Final = 1 << 20  # asked for; the kernel caps it (net.core.rmem_max)
_FILTER: Final = struct.Struct("=II")
_CAN_RAW_ERR_FILTER: Final = 2  # not in every Python's socket module
_SIOCGIFMTU: Final = 0x8921
_IFREQ: Final = struct.Struct("16si20x")


class SocketCanSocket:
    """One raw socket on a CAN interface; a ``FrameSocket``.

    Its own frames do not come back to it; other sockets on the machine see them.

    Attributes:
        name: Logical bus name.
        interface: Network interface (``vcan0``).
        fd: Descriptor that becomes readable when a frame waits; -1 once closed.
    """

    __slots__ = ("_batcher", "_socket", "fd", "interface", "name")

    def __init__(
        self,
        name: str,
        interface: str,
        filters: Filters | None = None,
        *,
        fd: bool = False,
        errors: bool = False,
    ) -> None:
        """Bind to ``interface``, which must be up.

        Args:
            name: Logical bus name.
            interface: Network interface.
            filters: (identifier, mask) pairs, flags included, of which a received frame
                must match one (the kernel filters); None receives every frame.
                They say nothing about error frames.
            fd: Carry FD frames as well; buffers then have rows of 72 bytes.
            errors: Receive the interface's error frames
                (:mod:`dftc_rt.bus.error_frames`) among the others.

        Raises:
            InputError: There are too many filters.
            EnvironmentLacksError: The kernel has no AF_CAN, or refuses it.
            BusError: There is no such CAN interface, it is down, or is set to classical
                frames where FD is asked for.
        """
        self.name = name
        self.interface = interface
        if filters is not None:
            filters = check_filters(filters)
        try:
            raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except OSError as error:
            raise EnvironmentLacksError(
                f"no SocketCAN in this kernel ({error.strerror})",
                "load the modules can-raw and vcan, or use --bus unix",
            ) from error
        try:
            raw.setblocking(False)
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 0)
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            if filters is not None:
                raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, _packed(filters))
            if errors:
                wanted = struct.pack("=I", ALL_CLASSES)
                raw.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, wanted)
            if fd:
                _check_mtu(raw, name, interface)
                raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            raw.bind((interface,))
            # Binding to an interface that is down succeeds and leaves the error behind.
            if code := raw.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                raise OSError(code, os.strerror(code))
        except OSError as error:
            raw.close()
            if isinstance(error, BusError):
                raise
            raise BusError(name, _refusal(interface, error)) from error
        self._socket = raw
        self._batcher = FrameBatcher(name if name == interface else f"{name} ({interface})")
        self.fd = raw.fileno()

    def send(self, frames: Frames, count: int) -> int:
        """Send the first ``count`` rows; return how many were accepted. Never blocks.

        Fewer are accepted while the interface's transmit queue is full.

        Raises:
            BusError: The interface is down or gone.
        """
        return self._batcher.send(self.fd, frames, count)

    def receive(self, frames: Frames) -> int:
        """Fill ``frames`` from row 0; return how many frames came. Never blocks.

        Raises:
            BusError: The interface is down or gone.
        """
        return self._batcher.receive(self.fd, frames)

    def set_filters(self, filters: Filters | None) -> None:
        """Have the kernel hand over only frames that one of ``filters`` takes; None: all.

        What waits already comes still.

        Raises:
            InputError: There are too many.
            BusError: The socket is closed.
        """
        packed = _packed(check_filters(filters))
        try:
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed)
        except OSError as error:
            raise BusError(self.name, f"no filters set ({error.strerror})") from error

    def close(self) -> None:
        """Leave the bus."""
        self.fd = -1
        self._socket.close()


def _packed(filters: Filters) -> bytes:
    """Return a set as an array of ``struct can_filter``; error frames are never received."""
    return b"".join(_FILTER.pack(can_id, mask & ~ERR_FLAG) for can_id, mask in filters)


def _check_mtu(raw: socket.socket, name: str, interface: str) -> None:
    """Refuse an interface that would refuse the first FD frame.

    Raises:
        BusError: It is set to classical frames.
        OSError: There is no such interface.
    """
    answer = fcntl.ioctl(raw, _SIOCGIFMTU, _IFREQ.pack(os.fsencode(interface)[:15], 0))
    _, mtu = _IFREQ.unpack(answer)
    if mtu < FD_FRAME_SIZE:
        raise BusError(
            name,
            f"the interface {interface} is set to classical frames (mtu {mtu}), "
            f"this profile's are CAN FD (mtu {FD_FRAME_SIZE})",
        )


def _refusal(interface: str, error: OSError) -> str:
    if error.errno == errno.ENODEV:
        return f"there is no CAN interface {interface}"
    if error.errno == errno.ENETDOWN:
        return f"the interface {interface} is down (ip link set {interface} up)"
    return f"cannot open {interface} ({error.strerror})"
