"""Wait until a frame can be received on any of several buses.

``select.poll`` and ``select.epoll`` round a timeout up to whole milliseconds, which
is a cycle; ``ppoll`` takes nanoseconds.
"""

from __future__ import annotations

import ctypes
import errno
import os
import time
from collections.abc import Iterable, Sequence
from typing import Final

from dftc_rt.bus.interface import FrameSocket

_POLLIN: Final = 0x001


class _PollFd(ctypes.Structure):
    _fields_ = (
        ("fd", ctypes.c_int),
        ("events", ctypes.c_short),
        ("revents", ctypes.c_short),
    )


class _TimeSpec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


_libc = ctypes.CDLL(None, use_errno=True)  # gives the GIL away while it waits
_ppoll = _libc.ppoll
_ppoll.argtypes = (ctypes.c_void_p, ctypes.c_ulong, ctypes.c_void_p, ctypes.c_void_p)
_ppoll.restype = ctypes.c_int


class Waiter:
    """Waits on a fixed set of descriptors; built once, used every cycle."""

    __slots__ = ("_count", "_fds", "_fds_address", "_timeout", "_timeout_address")

    def __init__(self, fds: Iterable[int]) -> None:
        """Watch ``fds``; negative ones (in-process links) are always ready."""
        chosen = list(fds)
        self._fds = (_PollFd * len(chosen))(*[_PollFd(fd, _POLLIN, 0) for fd in chosen])
        self._fds_address = ctypes.addressof(self._fds)
        self._count = len(chosen) if all(fd >= 0 for fd in chosen) else 0
        self._timeout = _TimeSpec()
        self._timeout_address = ctypes.addressof(self._timeout)

    def wait(self, timeout_s: float) -> bool:
        """Block until a frame waits, a bus has gone away, or ``timeout_s`` seconds passed.

        A signal's Python handler runs, then the wait goes on for what is left. With an
        in-process link among the sockets it returns at once: nothing there comes by
        waiting.

        Returns:
            Whether some descriptor is ready.

        Raises:
            OSError: The kernel refuses to poll (a programming error).
        """
        if not self._count:
            return True
        deadline = time.monotonic() + timeout_s
        while True:
            nanoseconds = int(timeout_s * 1e9) if timeout_s > 0.0 else 0
            self._timeout.seconds, self._timeout.nanoseconds = divmod(nanoseconds, 1_000_000_000)
            ready: int = _ppoll(self._fds_address, self._count, self._timeout_address, None)
            if ready >= 0:
                return ready > 0
            code = ctypes.get_errno()
            if code != errno.EINTR:
                raise OSError(code, os.strerror(code))
            timeout_s = deadline - time.monotonic()

    def ready(self, index: int) -> bool:
        """Return whether the descriptor at ``index`` was ready when ``wait`` last returned.

        With an in-process link among them, all are.
        """
        return not self._count or bool(self._fds[index].revents)


def wait(sockets: Sequence[FrameSocket], timeout_s: float) -> bool:
    """Block until one of ``sockets`` can be received from, or ``timeout_s`` seconds passed.

    For set-up and tools; a loop builds a ``Waiter`` once.
    """
    return Waiter(socket.fd for socket in sockets).wait(timeout_s)
