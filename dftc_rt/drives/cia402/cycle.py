"""The cyclic half of CiA 402: arrays and kernel calls, no I/O.

Per cycle: ``begin``; ``sync`` for each bus; ``decode`` as answers come; ``command`` once;
``encode`` for each bus.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames
from dftc_rt.drives.cia402 import codec, states
from dftc_rt.drives.cia402 import objects as od
from dftc_rt.drives.interface import (
    GOAL_OFF,
    GOAL_OPERATE,
    GOAL_READY,
    GOAL_STOP,
    DriveConfig,
    SetUp,
)
from dftc_rt.drives.membership import members_by_bus, missing, node_ids
from dftc_rt.drives.scale import ScaleTable, quantise_torque

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_CAPACITY: Final = 512  # rows of the largest batch that decode takes


@njit(cache=True)
def steer(goal: int, status: I64, controlword: I64) -> None:
    """Choose each drive's controlword.

    Operation is only ever enabled from switched on, where set-up left the drive: one that
    dropped out (fault, quick stop, lost connection) is not switched on again by the loop.

    Args:
        goal: One of ``GOAL_*``.
        status: Last statusword of each drive, (n,).
        controlword: Filled, (n,).
    """
    for i in range(status.shape[0]):
        if goal == GOAL_OPERATE:
            state = states.state_of(status[i])
            up = state in (states.SWITCHED_ON, states.OPERATION_ENABLED)
            controlword[i] = states.CW_ENABLE_OPERATION if up else states.CW_SHUTDOWN
        elif goal == GOAL_READY:
            controlword[i] = states.CW_SWITCH_ON
        elif goal == GOAL_STOP:
            controlword[i] = states.CW_QUICK_STOP
        else:
            controlword[i] = states.CW_DISABLE_VOLTAGE


class Cia402Cycle:
    """Feedback and commands of all drives of a robot.

    Attributes:
        q: Joint positions, (n,), rad (m).
        v: Joint velocities, (n,), rad/s (m/s).
        torque_actual: Torque by the drive's own account, (n,), Nm (N): current times
            nominal torque constant, so it does not know of a loss. Every tenth SYNC.
        sent: Torques as sent, (n,), Nm (N).
        goal: One of ``GOAL_*``.
        seen: Bit k is set when a frame of kind k (codec.KIND_*) came this cycle, (n,).
        status: Statuswords, (n,).
        emergency: Last emergency error code of each drive, (n,).
        emergencies: Emergencies of each drive so far, (n,).
        heartbeats: Heartbeats of each drive so far, (n,).
        other: Per row of the last decode: 0 feedback, 1 not ours, 2 emergency, 3 short.
        counter: SYNC counter of this cycle, 1 to 240.
    """

    def __init__(self, drives: Sequence[DriveConfig], buses: int, rate_hz: float) -> None:
        """Allocate everything and compile the kernels.

        Args:
            drives: The drives, in joint order.
            buses: Number of buses.
            rate_hz: Cycles per second.

        Raises:
            InputError: Two drives of a bus share a node id.
        """
        n = len(drives)
        self.values: F64 = np.zeros((codec.F_ROWS, n))
        self.words: I64 = np.zeros((codec.W_ROWS, n), dtype=np.int64)
        self.q = self.values[codec.F_Q]
        self.v = self.values[codec.F_V]
        self.torque_actual = self.values[codec.F_TORQUE]
        self.seen = self.words[codec.W_SEEN]
        self.status = self.words[codec.W_STATUS]
        self.emergency = self.words[codec.W_EMCY]
        self.emergencies = self.words[codec.W_EMCYS]
        self.heartbeats = self.words[codec.W_HEARTBEATS]
        self.sent: F64 = np.zeros(n)
        self.counts: I64 = np.zeros(n, dtype=np.int64)
        self.controlword: I64 = np.zeros(n, dtype=np.int64)
        self.other = np.zeros(_CAPACITY, dtype=np.uint8)
        self.goal = GOAL_OFF
        self.counter = 0
        self.scale = ScaleTable.of([drive.scale for drive in drives])
        self._node_ids = node_ids(drives)
        self._members = members_by_bus(drives, buses)
        self._lookups = [
            codec.feedback_lookup(members, self._node_ids) for members in self._members
        ]
        self._heartbeat_every = max(round(od.MASTER_HEARTBEAT_MS * 1e-3 * rate_hz), 1)
        self._heartbeat_in = 0
        self._compile()

    def _compile(self) -> None:
        """Call every kernel on frames that change nothing."""
        out = np.zeros((len(self.q) + 2, 16), dtype=np.uint8)
        self.command(np.zeros_like(self.q))
        for bus in range(len(self._members)):
            self.sync(bus, out)
            self.encode(bus, out)
            self.decode(bus, out, 0)
            self.missing(bus)

    def start(self, found: SetUp) -> None:
        """Begin from the states and positions that set-up read."""
        self.words[:] = 0
        self.status[:] = found.statusword
        self.words[codec.W_COUNTS] = found.counts
        self.words[codec.W_STARTED] = 1
        self.q[:] = self.scale.position(found.counts)
        self.v[:] = 0.0
        self.counter = 0
        self._heartbeat_in = 0

    def begin(self) -> None:
        """Begin a cycle: no answer has been seen yet."""
        self.seen[:] = 0
        self.counter = self.counter % od.SYNC_COUNTER_OVERFLOW + 1
        if self._heartbeat_in == 0:
            self._heartbeat_in = self._heartbeat_every
        self._heartbeat_in -= 1

    def sync(self, bus: int, out: Frames, row: int = 0) -> int:
        """Fill in SYNC at ``row``; return the row after it."""
        rows: int = codec.encode_sync(out, row, self.counter)
        return rows

    def decode(self, bus: int, frames: Frames, count: int) -> int:
        """Take in frames of one bus; return how many rows ``other`` marks."""
        marked: int = codec.decode_feedback(
            frames, count, self._lookups[bus], self.scale.values, self.values, self.words,
            self.other,
        )  # fmt: skip
        return marked

    def missing(self, bus: int) -> int:
        """Return how many joints of one bus have not answered in this cycle."""
        count: int = missing(self.seen, self._members[bus])
        return count

    def command(self, tau: F64) -> None:
        """Limit and quantise the torques of all joints, (n,), Nm, into ``sent``."""
        quantise_torque(tau, self.scale.values, self.counts, self.sent)
        steer(self.goal, self.status, self.controlword)

    def encode(self, bus: int, out: Frames) -> int:
        """Fill in the RPDOs of one bus, and the heartbeat when it is due."""
        rows: int = codec.encode_commands(
            out, 0, self._members[bus], self._node_ids, self.controlword, self.counts
        )
        if self._heartbeat_in == 0:
            rows = codec.encode_heartbeat(out, rows, od.MASTER_NODE_ID, od.OPERATIONAL)
        return rows
