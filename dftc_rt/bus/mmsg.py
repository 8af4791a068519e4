"""Batches of frames through one system call: ``sendmmsg`` and ``recvmmsg``.

A frame buffer needs one message header and one I/O vector a row. They hold
nothing but addresses, so they are built once for a buffer and found again when
the same buffer comes back: sending or receiving is then one call through ctypes.
"""

from __future__ import annotations

import ctypes
import errno
import os
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import FD_FRAME_SIZE, FDF, FRAME_SIZE, Frames
from dftc_rt.errors import BusError

MSG_DONTWAIT: Final = 0x40
MSG_NOSIGNAL: Final = 0x4000
MSG_TRUNC: Final = 0x20  # tell the whole length of a record that did not fit its row
BATCH_LIMIT: Final = 1024  # UIO_MAXIOV: the kernel takes no more messages in one call

_KEPT_BUFFERS: Final = 8
_KEPT_ADDRESSES: Final = 64


class _IoVec(ctypes.Structure):
    _fields_ = (("base", ctypes.c_size_t), ("size", ctypes.c_size_t))


class _MsgHdr(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_size_t),
        ("namelen", ctypes.c_uint32),
        ("iov", ctypes.c_size_t),
        ("iovlen", ctypes.c_size_t),
        ("control", ctypes.c_size_t),
        ("controllen", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _MMsgHdr(ctypes.Structure):
    _fields_ = (("hdr", _MsgHdr), ("length", ctypes.c_uint32))


_IOVEC: Final = np.dtype(_IoVec)
_MMSGHDR: Final = np.dtype(_MMsgHdr)

# PyDLL keeps the GIL: with MSG_DONTWAIT the call cannot block, and giving the GIL
# away would let another thread keep it for its whole switch interval.
_libc = ctypes.PyDLL(None, use_errno=True)
_sendmmsg = _libc.sendmmsg
_sendmmsg.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int)
_sendmmsg.restype = ctypes.c_int
_recvmmsg = _libc.recvmmsg
_recvmmsg.argtypes = (
    ctypes.c_int,
    ctypes.c_void_p,
    ctypes.c_uint,
    ctypes.c_int,
    ctypes.c_void_p,
)
_recvmmsg.restype = ctypes.c_int


@numba.njit("void(uint8[:, ::1], int64, uint64[:])", cache=True)
def _sizes(frames: Frames, count: int, sizes: NDArray[np.uint64]) -> None:
    """Send classical frames of an FD buffer as what they are: records of 16 bytes."""
    for i in range(count):
        sizes[i] = FD_FRAME_SIZE if frames[i, 5] & FDF else FRAME_SIZE


@numba.njit("int64(uint8[:, ::1], uint32[:], int64)", cache=True)
def _mark(frames: Frames, lengths: NDArray[np.uint32], count: int) -> int:
    """Set FDF of the FD frames that came; return the first row that is no frame, or count."""
    for i in range(count):
        if lengths[i] == FD_FRAME_SIZE:
            frames[i, 5] |= FDF
        elif lengths[i] == FRAME_SIZE:
            frames[i, 5] = 0
        else:
            return i
    return count


@numba.njit("int64(uint32[:], int64, int64)", cache=True)
def _first_of_other_length(lengths: NDArray[np.uint32], count: int, size: int) -> int:
    for i in range(count):
        if lengths[i] != size:
            return i
    return count


class _Headers:
    """Message headers of one frame buffer.

    Attributes:
        address: Address of the first header, to be handed to the kernel.
        capacity: Rows of the longest buffer seen at this address.
        frame_size: Bytes of a row.
        fd: Whether rows are FD frames, among which there may be classical ones.
        sizes: Bytes that a row has for the kernel, one a row.
        lengths: Bytes that the kernel sent or received, one a row.
    """

    __slots__ = (
        "_headers", "_vectors", "address", "capacity", "fd", "frame_size", "lengths", "sizes",
    )  # fmt: skip

    def __init__(self, buffer_address: int, capacity: int, frame_size: int) -> None:
        rows = np.arange(capacity, dtype=np.uint64)
        self._vectors = np.zeros(capacity, dtype=_IOVEC)
        self._vectors["base"] = buffer_address + rows * np.uint64(frame_size)
        self._vectors["size"] = frame_size
        self._headers = np.zeros(capacity, dtype=_MMSGHDR)
        self._headers["hdr"]["iov"] = self._vectors.ctypes.data + rows * np.uint64(_IOVEC.itemsize)
        self._headers["hdr"]["iovlen"] = 1
        self.address = int(self._headers.ctypes.data)
        self.capacity = capacity
        self.frame_size = frame_size
        self.fd = frame_size == FD_FRAME_SIZE
        self.sizes: NDArray[np.uint64] = self._vectors["size"]
        self.lengths: NDArray[np.uint32] = self._headers["length"]


class FrameBatcher:
    """Sends and receives whole buffers of frames on one descriptor.

    Buffers are recognised by identity (whole arrays, kept alive by this object;
    the fast case) or by address (slices, about 1 µs more).
    """

    def __init__(self, name: str) -> None:
        """Keep ``name``, the logical bus that errors are about."""
        self._name = name
        self._by_identity: dict[int, tuple[Frames, _Headers]] = {}
        self._by_address: dict[tuple[int, int], _Headers] = {}

    def send(self, fd: int, frames: Frames, count: int) -> int:
        """Send the first ``count`` rows; return how many were accepted. Never blocks.

        Args:
            fd: Descriptor of a socket that keeps record boundaries.
            frames: uint8, shape ``(capacity, frame size)``, C-contiguous.
            count: Rows to send.

        Raises:
            BusError: The peer or the interface has gone away.
            ValueError: ``count`` exceeds the buffer, or the buffer has another layout.
        """
        known = self._by_identity.get(id(frames))
        headers = known[1] if known is not None else self._find(frames)
        if count > len(frames):
            raise ValueError(f"{count} frames asked for, the buffer holds {len(frames)}")
        if count <= 0:
            return 0
        if headers.fd:
            _sizes(frames, count, headers.sizes)
        sent: int = _sendmmsg(fd, headers.address, count, MSG_DONTWAIT | MSG_NOSIGNAL)
        if sent < 0:
            code = ctypes.get_errno()
            if code in (errno.EAGAIN, errno.ENOBUFS):
                return 0
            if code == errno.EINTR:
                return self.send(fd, frames, count)
            raise BusError(self._name, gone(code))
        return sent

    def receive(self, fd: int, frames: Frames) -> int:
        """Fill ``frames`` from row 0; return how many frames came. Never blocks.

        Records of another length than a row are no frames and are left out. Rows of 72 bytes take
        classical frames too; FDF tells which are not.

        Raises:
            BusError: The peer or the interface has gone away.
            ValueError: The buffer is not a C-contiguous uint8 matrix.
        """
        known = self._by_identity.get(id(frames))
        headers = known[1] if known is not None else self._find(frames)
        if headers.fd:
            headers.sizes[:] = FD_FRAME_SIZE
        count: int = _recvmmsg(fd, headers.address, len(frames), MSG_DONTWAIT | MSG_TRUNC, None)
        if count < 0:
            code = ctypes.get_errno()
            if code == errno.EAGAIN:
                return 0
            if code == errno.EINTR:
                return self.receive(fd, frames)
            if code == errno.ECONNRESET:
                # The peer closed with records unread. The error is cleared by having
                # been told; what the peer sent before is still there to be received.
                count = _recvmmsg(fd, headers.address, len(frames), MSG_DONTWAIT | MSG_TRUNC, None)
            if count < 0:
                raise BusError(self._name, gone(code))
        whole: int
        if headers.fd:
            whole = _mark(frames, headers.lengths, count)
        else:
            whole = _first_of_other_length(headers.lengths, count, headers.frame_size)
        if whole == count:
            return count
        return self._sift(frames, headers, whole, count)

    def _sift(self, frames: Frames, headers: _Headers, whole: int, count: int) -> int:
        """Close the gaps that odd records left; an empty record is the end."""
        if headers.lengths[0] == 0:
            raise BusError(self._name, gone(0))
        kept = whole
        for row in range(whole, count):
            if headers.lengths[row] == 0:
                break
            if headers.fd:
                fits = _mark(frames[row : row + 1], headers.lengths[row : row + 1], 1) == 1
            else:
                fits = headers.lengths[row] == headers.frame_size
            if fits:
                frames[kept] = frames[row]
                kept += 1
        return kept

    def _find(self, frames: Frames) -> _Headers:
        if frames.dtype != np.uint8 or frames.ndim != 2 or not frames.flags.c_contiguous:
            raise ValueError("a frame buffer is a C-contiguous uint8 matrix")
        capacity, frame_size = frames.shape
        key = (int(frames.ctypes.data), frame_size)
        headers = self._by_address.get(key)
        if headers is None or headers.capacity < capacity:
            if len(self._by_address) >= _KEPT_ADDRESSES:
                self._by_address.clear()
            headers = self._by_address[key] = _Headers(key[0], capacity, frame_size)
        if frames.base is None and len(self._by_identity) < _KEPT_BUFFERS:
            self._by_identity[id(frames)] = (frames, headers)
        return headers


def gone(code: int) -> str:
    """Return what the error of a socket says about its bus; 0: closed by the other end."""
    if code == errno.ENETDOWN:
        return "the interface went down"
    if code in (errno.ENODEV, errno.ENXIO):
        return "the interface is gone: unplugged or removed"
    return f"the bus has gone away ({os.strerror(code) if code else 'closed by its owner'})"
