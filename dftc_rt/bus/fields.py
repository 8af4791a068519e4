"""Fields of a frame in a batch, for kernels."""

from __future__ import annotations

import numba
import numpy as np

from dftc_rt.bus.frame import Frames


@numba.njit("int64(uint8[:, ::1], int64)", cache=True, inline="always")
def can_id(frames: Frames, row: int) -> int:
    """Return identifier and flags of the frame in ``row``, as they stand (u32)."""
    return int(
        np.int64(frames[row, 0])
        | np.int64(frames[row, 1]) << 8
        | np.int64(frames[row, 2]) << 16
        | np.int64(frames[row, 3]) << 24
    )


@numba.njit("int64(uint8[:, ::1], int64)", cache=True, inline="always")
def length_code(frames: Frames, row: int) -> int:
    """Return the length that the frame in ``row`` announces, 0 … 8."""
    return min(int(np.int64(frames[row, 4])), 8)


@numba.njit("int64(uint8[:, ::1], int64)", cache=True, inline="always")
def data_bytes(frames: Frames, row: int) -> int:
    """Return the data bytes of the frame in ``row`` on the wire: none in a remote frame."""
    if frames[row, 3] & 0x40:
        return 0
    return min(int(np.int64(frames[row, 4])), 8)
