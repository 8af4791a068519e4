"""What has gone over one bus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

FRAMES: Final = 0  # the columns of the totals that a bus keeps
NOMINAL: Final = 1
EXACT: Final = 2
WORST: Final = 3
FAST: Final = 3  # from a column to its bits at the data bit rate
TOTALS: Final = 7


def busy_s(totals: NDArray[np.int64], bitrate: int, data_bitrate: int) -> NDArray[np.float64]:
    """Seconds that the frames so far would have occupied the wire.

    Args:
        totals: Shape ``(..., 7)``.
        bitrate: Bits per second.
        data_bitrate: Of the data part of FD frames.
    """
    fast: NDArray[np.float64] = totals[..., FAST + EXACT] / data_bitrate
    return totals[..., EXACT] / bitrate + fast


@dataclass(frozen=True, slots=True)
class BusStatistics:
    """Counts since the bus was opened. Bits are zero with timing ``off``.

    Attributes:
        bitrate: Bits per second of the bus that is stood in for.
        frames: Frames that won the bus (barriers are none).
        nominal_bits: Their bits without stuffing, intermission included.
        exact_bits: Their bits with the stuffing that their content causes.
        worst_bits: Their bits with the most stuffing that their lengths allow.
        data_bitrate: Bits per second of the data part of FD frames; 0 on a classical bus.
        nominal_data_bits: Bits at that rate, which the counts above leave out.
        exact_data_bits: The same with their own stuffing.
        worst_data_bits: The same with the most stuffing.
        latency_us: Longest time from readiness until a frame was through, µs, by
            identifier: the frames that were handed over with it and won against it, and its own;
            with timing ``pace`` all that it waited for.
        dropped: Frames lost to clients that did not read them in time, clients that
            have left included.
        malformed: Records from clients that are no CAN frame.
        clients: Clients attached now.
        departed: Clients that have left.
        lost: Frames that faults of the bus took.
        errors: Transmissions that faults corrupted; ``exact_bits`` and ``worst_bits`` count them.
        duplicated: Frames that came twice.
        delayed: Frames that came late.
        babbled: Frames of a babbling node.
        late_mean_us: By how much frames were delivered later than they were through, µs, mean:
            the host's delay, which timing ``pace`` alone knows.
        late_max_us: The longest.
    """

    bitrate: int
    frames: int
    nominal_bits: int
    exact_bits: int
    worst_bits: int
    data_bitrate: int
    nominal_data_bits: int
    exact_data_bits: int
    worst_data_bits: int
    latency_us: dict[str, float]
    dropped: int
    malformed: int
    clients: int
    departed: int
    lost: int
    errors: int
    duplicated: int
    delayed: int
    babbled: int
    late_mean_us: float = 0.0
    late_max_us: float = 0.0

    @property
    def busy_s(self) -> float:
        """Seconds that the frames would have occupied the wire."""
        data_s = self.exact_data_bits / self.data_bitrate if self.data_bitrate else 0.0
        return self.exact_bits / self.bitrate + data_s

    def load(self, duration_s: float) -> float:
        """Return the share of ``duration_s`` seconds in which the wire was occupied."""
        return self.busy_s / duration_s
