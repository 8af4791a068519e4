"""CAN frames as the kernel lays them out, in rows of a byte matrix.

A batch of classical frames is a ``(capacity, 16)`` uint8 matrix whose rows are
``struct can_frame``: u32 identifier and flags (host order, little-endian here),
u8 length, 3 reserved bytes, 8 data bytes. A batch of FD frames is a
``(capacity, 72)`` matrix of ``struct canfd_frame``.

Source: Linux ``include/uapi/linux/can.h``.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

FRAME_SIZE: Final = 16
FD_FRAME_SIZE: Final = 72

EFF_FLAG: Final = 0x8000_0000  # 29-bit identifier
RTR_FLAG: Final = 0x4000_0000  # remote transmission request
ERR_FLAG: Final = 0x2000_0000  # error frame
SFF_MASK: Final = 0x0000_07FF
EFF_MASK: Final = 0x1FFF_FFFF

# Lock-step barrier: ends one side's share of a cycle. A link-level record: the
# user-space bus never forwards it to other nodes; on vcan it is a frame with this
# reserved extended identifier. Data: the cycle number, u64 little-endian.
BARRIER_ID: Final = EFF_FLAG | 0x1FFF_FFFE

# Flags in byte 5 of struct canfd_frame.
BRS: Final = 0x01  # the data part is sent at the data bit rate
ESI: Final = 0x02  # the sender is error passive
FDF: Final = 0x04  # it is an FD frame: a batch for FD may hold classical frames besides

FD_LENGTHS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Data bytes that a length code of CAN FD stands for."""

Frames = NDArray[np.uint8]


def frame_buffer(capacity: int, size: int = FRAME_SIZE) -> Frames:
    """Return an empty batch: uint8, shape ``(capacity, size)``, C-contiguous."""
    return np.zeros((capacity, size), dtype=np.uint8)


def pack(can_id: int, data: bytes) -> bytes:
    """Return one classical frame as its 16 bytes."""
    return can_id.to_bytes(4, "little") + bytes([len(data), 0, 0, 0]) + data.ljust(8, b"\0")


def pack_fd(can_id: int, data: bytes, flags: int = BRS) -> bytes:
    """Return one FD frame as its 72 bytes.

    Args:
        can_id: Identifier with flags.
        data: As many bytes as one of :data:`FD_LENGTHS` says.
        flags: ``BRS``, ``ESI``; ``FDF`` is added.
    """
    head = can_id.to_bytes(4, "little") + bytes([len(data), flags | FDF, 0, 0])
    return head + data.ljust(64, b"\0")


def unpack(frame: bytes | Frames) -> tuple[int, bytes]:
    """Return (identifier with flags, data) of one frame."""
    raw = bytes(frame)
    return int.from_bytes(raw[:4], "little"), raw[8 : 8 + raw[4]]
