"""Frames of drives that answer late, kept until they are due."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames


class LateAnswers:
    """Holds frames back, in the order in which each drive sent them.

    Attributes:
        any: Whether some drive is late or a frame still waits.
    """

    def __init__(self, drives: int) -> None:
        """Take the number of drives; none is late."""
        self.any = False
        self._delay_us = [0] * drives
        self._waiting: dict[int, deque[tuple[int, int, bytes]]] = {}  # bus -> due, sender, frame

    def delay(self, drive: int, delay_s: float) -> None:
        """Let what a drive sends from now on come ``delay_s`` later."""
        self._delay_us[drive] = round(delay_s * 1e6)
        self.any = self.any or delay_s > 0

    def pass_on(
        self, bus: int, now_us: int, out: Frames, rows: int, senders: NDArray[np.int32]
    ) -> int:
        """Take what is late out of a batch, and put in what has become due.

        What is due and finds no room in the batch waits for the next.

        Args:
            bus: Index of the bus.
            now_us: Rig time, us.
            out: Batch, (capacity, 16); changed.
            rows: Rows filled.
            senders: Drive of each row; changed.

        Returns:
            Rows filled now.
        """
        waiting = self._waiting.setdefault(bus, deque())
        behind = {sender for _, sender, _ in waiting}
        kept = 0
        for row in range(rows):
            sender = int(senders[row])
            if self._delay_us[sender] or sender in behind:
                waiting.append((now_us + self._delay_us[sender], sender, bytes(out[row])))
            else:
                out[kept], senders[kept] = out[row], sender
                kept += 1
        held: deque[tuple[int, int, bytes]] = deque()
        blocked: set[int] = set()  # senders of which an earlier frame still waits
        for due, sender, raw in waiting:
            if due <= now_us and sender not in blocked and kept < out.shape[0]:
                out[kept], senders[kept] = np.frombuffer(raw, dtype=np.uint8), sender
                kept += 1
            else:
                blocked.add(sender)
                held.append((due, sender, raw))
        self._waiting[bus] = held
        self.any = any(self._delay_us) or any(self._waiting.values())
        return kept
