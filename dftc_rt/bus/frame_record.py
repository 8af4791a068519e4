"""A frame as it lies in a log: when, on which bus, in which direction, and its bytes.

One record is 24 bytes, or 80 where frames are CAN FD, a whole number of float64, so that it
fits a ring of such; in CDR it is itself, as every record of a log is. Little-endian:

    0 t, float64 | 8 id, uint32, with flags | 12 bus | 13 tx | 14 FD flags | 15 length | 16 data
"""

from __future__ import annotations

from typing import Any, Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.fields import can_id
from dftc_rt.bus.frame import BARRIER_ID, BRS, ESI, FD_FRAME_SIZE, FDF, Frames

_HEAD_BYTES: Final = 16
_FD_FLAGS: Final = BRS | ESI | FDF

Records = NDArray[np.void]
"""Shape (K,), of :func:`record_dtype`."""


def record_data_bytes(frame_size: int) -> int:
    """Return the data bytes that a record has room for: 8, or 64 where frames are CAN FD.

    Args:
        frame_size: Bytes of a row of the buffers, 16 or 72.
    """
    return 64 if frame_size == FD_FRAME_SIZE else 8


def record_words(data: int) -> int:
    """Return the float64 that a record with room for so many data bytes takes."""
    return (_HEAD_BYTES + data) // 8


def record_dtype(data: int) -> np.dtype[Any]:
    """Return the layout of a record with room for so many data bytes."""
    return np.dtype(
        [
            ("t", "<f8"),
            ("id", "<u4"),
            ("bus", "u1"),
            ("tx", "?"),
            ("flags", "u1"),
            ("length", "u1"),
            ("data", "u1", (data,)),
        ]
    )


def frames_of(records: Records, frame_size: int) -> Frames:
    """Return records as the rows of a batch, uint8, shape ``(K, frame_size)``."""
    frames = np.zeros((len(records), frame_size), np.uint8)
    frames[:, :4] = np.ascontiguousarray(records["id"]).view(np.uint8).reshape(-1, 4)
    frames[:, 4] = records["length"]
    frames[:, 5] = records["flags"]
    room = min(records["data"].shape[1], frame_size - 8)
    frames[:, 8 : 8 + room] = records["data"][:, :room]
    return frames


@numba.njit("int64(uint8[:, ::1], int64, int64, int64, int64, uint8[:, ::1])", cache=True)
def _write(
    frames: Frames, count: int, barriers: int, bus: int, tx: int, raw: NDArray[np.uint8]
) -> int:
    """Fill in everything but the time; return how many records that made."""
    kept = 0
    for row in range(count):
        if not barriers and can_id(frames, row) == BARRIER_ID:
            continue
        out = raw[kept]
        for i in range(4):
            out[8 + i] = frames[row, i]
        out[12] = bus
        out[13] = tx
        fd = frames.shape[1] == FD_FRAME_SIZE and frames[row, 5] & FDF
        out[14] = frames[row, 5] & _FD_FLAGS if fd else 0
        out[15] = frames[row, 4]
        length = min(np.int64(frames[row, 4]), frames.shape[1] - 8, raw.shape[1] - _HEAD_BYTES)
        for i in range(length):
            out[_HEAD_BYTES + i] = frames[row, 8 + i]
        for i in range(_HEAD_BYTES + length, raw.shape[1]):
            out[i] = 0
        kept += 1
    return kept


class RecordBatch:
    """Frames of one batch as records, in memory that is kept. Real-time safe.

    Attributes:
        words: The records as float64, shape (capacity, :func:`record_words`).
        raw: The same memory as bytes.
    """

    def __init__(self, capacity: int, data: int, *, barriers: bool) -> None:
        """Make room.

        Args:
            capacity: Most frames of a batch.
            data: Data bytes of a record.
            barriers: Whether to keep frames with the reserved identifier of a barrier; in
                lock-step they are no frames of the bus.
        """
        self.words = np.zeros((capacity, record_words(data)))
        self.raw = self.words.view(np.uint8)
        self._barriers = int(barriers)

    def fill(self, frames: Frames, count: int, t: float, bus: int, tx: bool) -> int:
        """Take the first ``count`` rows of a batch; return how many records they made.

        Args:
            frames: Batch, uint8, shape ``(rows, 16)`` or ``(rows, 72)``.
            count: Rows to take, at most the capacity.
            t: Time of all of them, s.
            bus: Index of the bus.
            tx: Whether they were sent, rather than received.
        """
        kept: int = _write(frames, count, self._barriers, bus, int(tx), self.raw)
        self.words[:kept, 0] = t
        return kept
