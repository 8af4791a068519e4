"""The cyclic half of the moteus profile: arrays and kernel calls, no I/O.

As with MIT drives there is no SYNC: what a cycle computes waits here and goes out at the next
tick, with the question for the state, and a drive answers each frame. So a command acts one
cycle after the measurement that it is made of.

A drive says in every answer in which mode it is, so that its state is not guessed: position
mode is "operation enabled", fault and time-out are "fault".
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.bus.frame import FD_FRAME_SIZE, Frames, frame_buffer
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import (
    GOAL_OFF,
    GOAL_OPERATE,
    GOAL_READY,
    DriveConfig,
    SetUp,
)
from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus.scale import scales_of, wire_table
from dftc_rt.drives.scale import ScaleTable, quantise_torque
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

COUNTS_PER_REV: Final = 1 << 24  # of the positions that set-up hands over
_CAPACITY: Final = 512  # rows of the largest batch that decode takes

_OFF: Final = int(states.STATE_BITS[states.SWITCH_ON_DISABLED])
_READY: Final = int(states.STATE_BITS[states.SWITCHED_ON])


@njit(cache=True)
def steer(goal: int, status: I64, asked: I64, after: I64) -> None:
    """Choose what each drive is sent at the next tick.

    Position mode is only ever entered from switched on, where set-up left the drive. One that
    has stopped by itself is not switched on again by the loop; one in fault is only asked, so
    that its fault code stays, until it is to be off.

    Args:
        goal: One of ``GOAL_*``. A stop is what "off" is: there is no quick stop.
        status: Last statusword of each drive, (n,).
        asked: Filled, (n,): QUERY, TORQUE or STOP.
        after: Filled, (n,): what the mode "stopped" stands for from now on.
    """
    for i in range(status.shape[0]):
        state = states.state_of(status[i])
        ready = state == states.SWITCHED_ON
        up = ready or state == states.OPERATION_ENABLED
        after[i] = _OFF
        if up and goal == GOAL_OPERATE:
            asked[i] = codec.TORQUE
            if ready:  # it may answer before it has changed its mode
                after[i] = _READY
        elif state == states.FAULT and goal in (GOAL_OPERATE, GOAL_READY):
            asked[i] = codec.QUERY
        else:
            asked[i] = codec.STOP
            if up and goal == GOAL_READY:
                after[i] = _READY


@njit(cache=True)
def _only_enabled(status: I64, counts: I64, sent: F64) -> None:
    """Make zero of the torques to drives that are not known to be in position mode."""
    for i in range(status.shape[0]):
        if states.state_of(status[i]) != states.OPERATION_ENABLED:
            counts[i] = 0
            sent[i] = 0.0


@njit(cache=True)
def _missing(seen: I64, members: I64) -> int:
    """Return how many of the members have not answered in this cycle."""
    count = 0
    for k in range(members.shape[0]):
        if seen[members[k]] == 0:
            count += 1
    return count


class MoteusCycle:
    """Feedback and commands of all drives of a robot.

    Attributes:
        q: Joint positions, (n,), rad (m).
        v: Joint velocities, (n,), rad/s (m/s).
        torque_actual: Torque by the drive's own account, (n,), Nm (N): it does not know of a
            loss.
        sent: Torques that go out at the next tick, (n,), Nm (N); 0 where none does.
        goal: One of ``GOAL_*``.
        seen: 1 when an answer came this cycle, (n,).
        status: CiA 402 statuswords that say the same as the mode, (n,).
        emergency: 0: the protocol has none, (n,).
        mode: Modes of the last answers, (n,).
        fault: Fault codes, (n,), of the last answers that had one.
        other: Per row of the last decode: 0 feedback, 1 not ours, 3 without feedback.
    """

    def __init__(self, drives: Sequence[DriveConfig], buses: int, rate_hz: float) -> None:
        """Allocate everything and compile the kernels.

        Args:
            drives: The drives, in joint order, with ``MoteusScale``.
            buses: Number of buses.
            rate_hz: Cycles per second; nothing here depends on it.

        Raises:
            InputError: Two drives of a bus share a node id, or one is of another profile.
        """
        n = len(drives)
        scales = scales_of(drives)
        self.values: F64 = np.zeros((codec.F_ROWS, n))
        self.words: I64 = np.zeros((codec.W_ROWS, n), dtype=np.int64)
        self.q = self.values[codec.F_Q]
        self.v = self.values[codec.F_V]
        self.torque_actual = self.values[codec.F_TORQUE]
        self.seen = self.words[codec.W_SEEN]
        self.status = self.words[codec.W_STATUS]
        self.emergency = np.zeros(n, dtype=np.int64)
        self.mode = self.words[codec.W_MODE]
        self.fault = self.words[codec.W_FAULT]
        self.sent: F64 = np.zeros(n)
        self.counts: I64 = np.zeros(n, dtype=np.int64)
        self.other = np.zeros(_CAPACITY, dtype=np.uint8)
        self.goal = GOAL_OFF
        self._asked = self.words[codec.W_ASKED]
        self._after = self.words[codec.W_AFTER]
        self._found: F64 = np.zeros(5)
        self._scale = ScaleTable.of(scales).values
        self._wire = wire_table(scales)
        self._host_id = scales[0].host_id
        self._timeout = scales[0].timeout
        self._node_ids = np.array([drive.node_id for drive in drives], dtype=np.int64)
        self._members = [
            np.array([i for i, drive in enumerate(drives) if drive.bus == bus], dtype=np.int64)
            for bus in range(buses)
        ]
        self._lookups = [np.full(128, -1, dtype=np.int32) for _ in range(buses)]
        for members, lookup in zip(self._members, self._lookups, strict=True):
            ids = self._node_ids[members].tolist()
            if len(set(ids)) != len(ids):
                raise InputError("drives", f"node ids {ids} on one bus", "all different")
            lookup[ids] = members
        self._compile()

    def _compile(self) -> None:
        """Call every kernel on frames that change nothing."""
        out = frame_buffer(len(self.q), FD_FRAME_SIZE)
        self.command(np.zeros_like(self.q))
        for bus in range(len(self._members)):
            self.sync(bus, out)
            self.decode(bus, out, 0)
            self.missing(bus)

    def start(self, found: SetUp) -> None:
        """Begin from the states and positions that set-up read; at first drives are asked only."""
        self.words[:] = 0
        self.status[:] = found.statusword
        self._after[:] = found.statusword
        self.counts[:] = 0
        self.sent[:] = 0.0
        turns = found.counts * (2.0 * np.pi / COUNTS_PER_REV)
        self.q[:] = self._wire[codec.SIGN] * turns - self._wire[codec.ZERO]
        self.v[:] = 0.0

    def begin(self) -> None:
        """Begin a cycle: no answer has been seen yet."""
        self.seen[:] = 0

    def sync(self, bus: int, out: Frames, row: int = 0) -> int:
        """Fill in, from ``row`` on, what the last cycle has for each drive of one bus."""
        rows: int = codec.encode_cycle(
            out, row, self._members[bus], self._node_ids, self._host_id, self._asked,
            self.counts, self._timeout,
        )  # fmt: skip
        return rows

    def decode(self, bus: int, frames: Frames, count: int) -> int:
        """Take in frames of one bus; return how many rows ``other`` marks."""
        marked: int = codec.decode_answers(
            frames, count, self._host_id, self._lookups[bus], self._wire, self.values,
            self.words, self._found, self.other,
        )  # fmt: skip
        return marked

    def missing(self, bus: int) -> int:
        """Return how many joints of one bus have not answered in this cycle."""
        count: int = _missing(self.seen, self._members[bus])
        return count

    def command(self, tau: F64) -> None:
        """Limit and quantise the torques of all joints, (n,), Nm, for the next tick."""
        steer(self.goal, self.status, self._asked, self._after)
        quantise_torque(tau, self._scale, self.counts, self.sent)
        if self.goal != GOAL_OPERATE:
            self.sent[:] = 0.0
        _only_enabled(self.status, self.counts, self.sent)

    def encode(self, bus: int, out: Frames) -> int:
        """Send nothing: the commands go out at the next tick."""
        return 0
