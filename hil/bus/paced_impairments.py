"""Faults of a bus whose frames take their time: what becomes of one transmission.

Corrupted frames contend again and delay others, and so does a babbling node. It holds one frame at
a time: what it could not send in time, the next overwrites.

Source: docs/faults.md; retransmission as in ISO 11898-1:2015, "Recovery management".
"""

from __future__ import annotations

from enum import Enum
from typing import Final

import numpy as np

from dftc_rt.bus.frame import Frames, frame_buffer, pack
from dftc_rt.config import faults as kinds
from hil.bus.confinement import ErrorCounters
from hil.bus.impairments import CONTROLLER, ERROR_BITS, SUSPEND_BITS, Impairments, matches

_NS: Final = 1_000_000_000


class Fate(Enum):
    """What becomes of a transmission."""

    THROUGH = 0
    TWICE = 1  # through, and once more
    AGAIN = 2  # corrupted: the sender repeats it
    LOST = 3


class PacedImpairments(Impairments):
    """The faults of one bus with timing ``pace``."""

    _anchor: tuple[int, float] = (0, 0.0)  # the same moment by the wire's clock, ns, and rig's, s

    def tie(self, now: int, t: float) -> None:
        """Say that rig time ``t``, s, is ``now``, ns, by the clock of the wire."""
        self._anchor = now, t

    def attempt(self, frames: Frames, row: int, node: int, copy: bool) -> Fate:
        """Decide on one transmission; ``counts.waste`` grows by its bits if nobody takes it.

        Args:
            frames: Batch.
            row: Row of the frame.
            node: Its sender.
            copy: It has come through once already: no third time.
        """
        node = max(node, CONTROLLER)
        number = int.from_bytes(frames[row, :4].tobytes(), "little")
        fate = Fate.THROUGH
        for fault in self._active:
            match fault:
                case kinds.FrameLossFault() if self._hits(fault, number):
                    self.counts.lost += 1
                    self._waste(frames, row, 0)
                    return Fate.LOST
                case kinds.FrameCorruptionFault() if matches(fault, number):
                    if self._rng.random() < fault.probability:
                        return self._corrupt(fault, frames, row, node)
                case kinds.FrameDuplicationFault() if not copy and self._hits(fault, number):
                    self.counts.duplicated += 1
                    fate = Fate.TWICE
                case _:
                    pass
        self._intact(node)
        return fate

    def late_ns(self, frames: Frames, row: int) -> int:
        """Return by how much a frame that is handed over now comes late, ns."""
        late = self._late(int.from_bytes(frames[row, :4].tobytes(), "little"))
        if late > 0.0:
            self.counts.delayed += 1
        return round(late * _NS)

    def babblers(self) -> list[int]:
        """Return which faults are a node that babbles."""
        return [k for k, f in enumerate(self._faults) if isinstance(f, kinds.BabbleFault)]

    def next_babble(self, k: int, now: int) -> tuple[Frames, int] | None:
        """Return the next frame of a babbling node; None while it is quiet.

        Args:
            k: Which fault.
            now: By the clock of the wire, ns.

        Returns:
            Batch of one frame, and when it is ready, ns: before ``now`` where the node had one
            since the last that it sent.
        """
        fault = self._faults[k]
        anchor, t = self._anchor
        present = t + (now - anchor) / _NS
        if not isinstance(fault, kinds.BabbleFault) or not fault.start_s <= present < fault.end_s:
            return None
        number = max(self._babbled[k] + 1, int((present - fault.start_s) * fault.rate_hz))
        self._babbled[k] = number
        self.counts.babbled += 1
        one = frame_buffer(1, self._out.shape[1])
        raw = pack(fault.can_id, b"\xaa" * fault.data_bytes)
        one[0, :16] = np.frombuffer(raw, dtype=np.uint8)
        return one, anchor + round((fault.start_s + number / fault.rate_hz - t) * _NS)

    def _corrupt(
        self, fault: kinds.FrameCorruptionFault, frames: Frames, row: int, node: int
    ) -> Fate:
        sender = self.counters.setdefault(node, ErrorCounters())
        passive = sender.state == "passive"
        self.counts.errors += 1
        self._waste(frames, row, ERROR_BITS + passive * SUSPEND_BITS)
        self._spoilt(node, sender)
        if fault.retransmit and node not in self._back:
            return Fate.AGAIN
        self.counts.lost += 1
        return Fate.LOST

    def _babble(self, t: float) -> None:
        """Nothing by the cycle: the wire asks for each frame."""
