"""What travels on a bus: every identifier with how often and how regularly it comes, and the bits.

For tools; the loop keeps no such account.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dftc_rt.bus.bits import exact_bits
from dftc_rt.bus.error_frames import ErrorCounts
from dftc_rt.bus.fd_bits import exact_fd_bits
from dftc_rt.bus.frame import EFF_FLAG, ERR_FLAG, FD_FRAME_SIZE, FDF, FRAME_SIZE, Frames, unpack


@dataclass(slots=True)
class Seen:
    """One identifier.

    Attributes:
        can_id: Identifier with flags.
        length: Data bytes of the last frame.
        data: Data of the last frame.
        frames: How many came.
        bit_s: Time on the wire of all of them, s.
        first: Time of the first, s.
        last: Time of the last, s.
        shortest: Shortest time between two, s; infinite before the second.
        longest: Longest time between two, s; 0 before the second.
    """

    can_id: int
    length: int = 0
    data: bytes = b""
    frames: int = 0
    bit_s: float = 0.0
    first: float = 0.0
    last: float = 0.0
    shortest: float = math.inf
    longest: float = 0.0

    @property
    def name(self) -> str:
        """The identifier as candump writes it: three digits, or eight for 29 bits."""
        digits = 8 if self.can_id & EFF_FLAG else 3
        return f"0x{self.can_id & 0x1FFF_FFFF:0{digits}X}"

    @property
    def period_s(self) -> float | None:
        """Mean time between two, s; None before the second."""
        return (self.last - self.first) / (self.frames - 1) if self.frames > 1 else None

    @property
    def jitter_s(self) -> float | None:
        """Longest less shortest time between two, s; None before the third."""
        return self.longest - self.shortest if self.frames > 2 else None


class Census:
    """What came over one bus.

    Attributes:
        seen: By identifier with flags, in the order of their first.
        errors: Its interface's error frames.
        frames: How many came, error frames aside.
        bit_s: Time on the wire of all of them, s: their own bits with their own stuffing.
    """

    def __init__(self, bitrate: int, data_bitrate: int | None = None) -> None:
        """Begin with nothing.

        Args:
            bitrate: Bits per second.
            data_bitrate: Of the data part of CAN FD frames.
        """
        self.seen: dict[int, Seen] = {}
        self.errors = ErrorCounts()
        self.frames = 0
        self.bit_s = 0.0
        self._bit_s = 1.0 / bitrate
        self._data_bit_s = 1.0 / data_bitrate if data_bitrate else self._bit_s

    def take(self, frames: Frames, count: int, stamps: Sequence[float]) -> None:
        """Take in the first ``count`` rows of a batch.

        Args:
            frames: uint8, shape ``(capacity, 16)`` or ``(capacity, 72)``.
            count: Rows filled.
            stamps: When each of them came, s, (count,).
        """
        wide = frames.shape[1] == FD_FRAME_SIZE
        for row, at in zip(range(count), stamps, strict=True):
            if wide and frames[row, 5] & FDF:
                can_id, data = unpack(frames[row])
                slow, fast = exact_fd_bits(frames, row)
                bit_s = slow * self._bit_s + fast * self._data_bit_s
            else:
                can_id, data = unpack(frames[row, :FRAME_SIZE])
                if can_id & ERR_FLAG:
                    self.errors.take(can_id, data)
                    continue
                bit_s = exact_bits(frames, row) * self._bit_s
            self.frames += 1
            self.bit_s += bit_s
            self._note(can_id, data, bit_s, at)

    def _note(self, can_id: int, data: bytes, bit_s: float, at: float) -> None:
        seen = self.seen.get(can_id)
        if seen is None:
            seen = self.seen[can_id] = Seen(can_id, first=at)
        else:
            between = at - seen.last
            seen.shortest, seen.longest = min(seen.shortest, between), max(seen.longest, between)
        seen.length, seen.data, seen.last = len(data), data, at
        seen.frames += 1
        seen.bit_s += bit_s
