"""A canopen network without a bus and without threads, for the rig's end of the wire.

Received frames are handed to ``notify``; what canopen wants to send lands in a list;
what it wants to send periodically is due in rig time, never in wall time.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import canopen
from canopen.network import PeriodicMessageTask

from dftc_rt.bus.frame import pack

NEVER = 1 << 62


class RigTask(PeriodicMessageTask):
    """A frame that is sent every so often in rig time."""

    def __init__(self, can_id: int, data: Iterable[int], period_us: int, due_us: int) -> None:
        self.can_id = can_id
        self.data = bytes(data)
        self.period_us = period_us
        self.due_us = due_us
        self.running = True

    def stop(self) -> None:
        """Send no more."""
        self.running = False

    def update(self, data: Iterable[int]) -> None:
        """Send these data from now on."""
        self.data = bytes(data)


class SilentNetwork(canopen.Network):
    """One bus as canopen's local nodes see it.

    Attributes:
        outbox: Frames to be sent, 16 bytes each.
        now_us: Rig time, µs, set by the owner.
        deadline_us: When the next periodic frame is due, µs.
    """

    def __init__(self) -> None:
        super().__init__()
        self.outbox: list[bytes] = []
        self.now_us = 0
        self.deadline_us = NEVER
        self._tasks: list[RigTask] = []

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Keep a frame for the next answer."""
        self.outbox.append(pack(can_id, bytes(data)))

    def send_periodic(self, can_id: int, data: Any, period: float, remote: bool = False) -> RigTask:
        """Start a periodic frame, first sent one period and a node's stagger from now.

        Heartbeats of nodes that were set up at the same instant would otherwise share
        one cycle for ever: each node waits one millisecond per node id.
        """
        period_us = max(round(period * 1e6), 1)
        task = RigTask(can_id, data, period_us, self.now_us + period_us + 1000 * (can_id & 0x7F))
        self._tasks.append(task)
        self._reschedule()
        return task

    def serve_timers(self) -> None:
        """Send every periodic frame that is due; one that is late is sent once."""
        for task in self._tasks:
            if task.running and self.now_us >= task.due_us:
                self.send_message(task.can_id, task.data)
                behind = (self.now_us - task.due_us) // task.period_us
                task.due_us += (behind + 1) * task.period_us
        self._reschedule()

    def _reschedule(self) -> None:
        """Forget stopped tasks and find the next deadline."""
        self._tasks = [task for task in self._tasks if task.running]
        self.deadline_us = min((task.due_us for task in self._tasks), default=NEVER)
