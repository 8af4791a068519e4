"""A lock-step run over the virtual bus, with every frame kept in the order of the wire."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from dftc_rt.bus.barrier import OUTSIDE
from dftc_rt.bus.frame import BARRIER_ID, Frames, unpack
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.cli.session import Session, open_session
from dftc_rt.cli.simulate import _DrainingSink
from dftc_rt.controller import connect
from dftc_rt.memory import MemorySink
from dftc_rt.rt.clock import LockstepClock
from hil.bus.statistics import BusStatistics
from hil.simulate import in_process_rig

SYNC = 0x080
Frame = tuple[int, bytes]


@dataclass
class Tap:
    """A node's socket that keeps what goes through it; a ``FrameSocket``.

    Attributes:
        frames: Identifier and data of everything, barriers left out.
        ends: How many they were when the rig ended a cycle.
    """

    socket: FrameSocket
    frames: list[Frame] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.socket.name

    @property
    def fd(self) -> int:
        return self.socket.fd

    def send(self, frames: Frames, count: int) -> int:
        self._keep(frames, count)  # the answer may come before send() returns
        assert self.socket.send(frames, count) == count
        return count

    def receive(self, frames: Frames) -> int:
        count = self.socket.receive(frames)
        self._keep(frames, count)
        last = unpack(frames[count - 1]) if count else (0, b"")
        if last[0] == BARRIER_ID and int.from_bytes(last[1], "little") < OUTSIDE:
            self.ends.append(len(self.frames))
        return count

    def close(self) -> None:
        self.socket.close()

    def _keep(self, frames: Frames, count: int) -> None:
        found = (unpack(frames[row]) for row in range(count))
        self.frames += [frame for frame in found if frame[0] != BARRIER_ID]

    def cycles(self) -> list[list[Frame]]:
        """Return the frames from each SYNC to before the next; what precedes is set-up."""
        at = [k for k, (can_id, _) in enumerate(self.frames) if can_id == SYNC]
        return [self.frames[i:j] for i, j in pairwise(at)]

    def exchanges(self) -> list[list[Frame]]:
        """Return the frames of each cycle but the first: from the rig's barrier to its next."""
        return [self.frames[i:j] for i, j in pairwise(self.ends)]


@dataclass(frozen=True)
class Captured:
    """What a run left.

    Attributes:
        opened: The session.
        taps: One a bus.
        statistics: What the buses counted themselves.
    """

    opened: Session
    taps: list[Tap]
    statistics: list[BusStatistics]


def run(scenario: str, settings: Sequence[str], log: Path) -> Captured:
    """Run a scenario in one process, in lock-step, and log it."""
    opened = open_session(scenario, settings)
    motion = np.empty((3, opened.robot.n))
    opened.parts.reference.target(0.0, motion)
    truth = MemorySink(opened.rig.size)
    with opened.recorder(log, epoch_ns=0) as recorder:
        cycles = _DrainingSink(opened.cycle.size, recorder.write_cycles)
        joined = in_process_rig(opened.scenario, opened.robot, motion, truth, recorder.write_event)
        taps = [Tap(socket) for socket in joined.sockets]
        executor = connect(
            opened.scenario, opened.parts, taps, LockstepClock(), cycles, recorder.write_event,
            lambda: False,
        )  # fmt: skip
        assert executor.run().end_state == "done"
        cycles.flush()
        recorder.write_rig(truth.records())
    return Captured(opened, taps, [port.statistics for port in joined.rig.ports])
