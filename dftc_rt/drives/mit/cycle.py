"""The cyclic half of the MIT protocol: arrays and kernel calls, no I/O.

There is no SYNC: a drive answers each command. What a cycle computes waits here and goes
out at the next tick, which so is to these drives what SYNC is to others, and a command acts
as late as theirs does: one cycle after the measurement that it is made of.

At a tick each drive is sent one frame: its torque, or, where its state is to change, the
special frame in place of it. Neither frame nor answer says in which mode a drive is; the
state is what the special frame that the drive answered last has put it into. A drive that
leaves motor mode by itself (its watchdog, a fault that it does not report) is not seen to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import (
    GOAL_OFF,
    GOAL_OPERATE,
    GOAL_READY,
    DriveConfig,
    SetUp,
)
from dftc_rt.drives.mit import codec
from dftc_rt.drives.mit.scale import T_CODES, scales_of, wire_table
from dftc_rt.drives.scale import MAX_COUNTS, TORQUE_PER_COUNT, ScaleTable
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_CAPACITY: Final = 512  # rows of the largest batch that decode takes

_OFF: Final = int(states.STATE_BITS[states.SWITCH_ON_DISABLED])
_READY: Final = int(states.STATE_BITS[states.SWITCHED_ON])
_ENABLED: Final = int(states.STATE_BITS[states.OPERATION_ENABLED])


@njit(cache=True)
def steer(goal: int, status: I64, asked: I64, after: I64) -> None:
    """Choose what each drive is sent at the next tick.

    Motor mode is only ever entered from switched on, where set-up left the drive: one that
    was told to leave it, or that reports an error, is not switched on again by the loop.

    Args:
        goal: One of ``GOAL_*``. A stop is what "off" is: there is no quick stop.
        status: Last statusword of each drive, (n,).
        asked: Filled, (n,): TORQUE, ENTER or LEAVE.
        after: Filled, (n,): statusword once that has been answered.
    """
    for i in range(status.shape[0]):
        state = states.state_of(status[i])
        up = state in (states.SWITCHED_ON, states.OPERATION_ENABLED)
        if goal == GOAL_OPERATE and up:
            enabled = state == states.OPERATION_ENABLED
            asked[i] = codec.TORQUE if enabled else codec.ENTER
            after[i] = _ENABLED
        else:
            asked[i] = codec.LEAVE
            after[i] = _READY if goal == GOAL_READY and up else _OFF


@njit(cache=True)
def quantise(tau: F64, scale: F64, asked: I64, code: I64, sent: F64) -> None:
    """Turn torques into codes, limited to what may be commanded, and back.

    The nearest code, of two the lower; a torque that is no number counts as zero.

    Args:
        tau: Wanted torques, (n,), Nm.
        scale: ``ScaleTable.values``, in half steps.
        asked: What each drive is sent, (n,); without TORQUE no torque is.
        code: Filled, (n,).
        sent: Filled with the torque that those codes mean, (n,), Nm.
    """
    for i in range(tau.shape[0]):
        halves = tau[i] / scale[TORQUE_PER_COUNT, i]
        limit = scale[MAX_COUNTS, i]
        if math.isnan(halves):
            halves = 0.0
        halves = min(max(halves, -limit), limit)
        code[i] = np.int64(math.ceil(0.5 * (halves + T_CODES) - 0.5))
        sent[i] = 0.0
        if asked[i] == codec.TORQUE:
            sent[i] = (2 * code[i] - T_CODES) * scale[TORQUE_PER_COUNT, i]


@njit(cache=True)
def _missing(seen: I64, members: I64) -> int:
    """Return how many of the members have not answered in this cycle."""
    count = 0
    for k in range(members.shape[0]):
        if seen[members[k]] == 0:
            count += 1
    return count


class MitCycle:
    """Feedback and commands of all drives of a robot.

    Attributes:
        q: Joint positions, (n,), rad (m).
        v: Joint velocities, (n,), rad/s (m/s).
        torque_actual: Torque by the drive's own account, (n,), Nm (N): current times
            nominal torque constant, so it does not know of a loss.
        sent: Torques that go out at the next tick, (n,), Nm (N); 0 where none does.
        goal: One of ``GOAL_*``.
        seen: 1 when an answer came this cycle, (n,).
        status: CiA 402 statuswords that say the same as the mode, (n,).
        emergency: 0: the protocol has none, (n,).
        error: Error codes of the last answers, (n,); 0 from drives that send none.
        temperature: Temperatures of the last answers, as sent, (n,).
        other: Per row of the last decode: 0 feedback, 1 not ours, 3 short.
    """

    def __init__(self, drives: Sequence[DriveConfig], buses: int, rate_hz: float) -> None:
        """Allocate everything and compile the kernels.

        Args:
            drives: The drives, in joint order, with the ranges of ``MitScale``.
            buses: Number of buses.
            rate_hz: Cycles per second; nothing here depends on it.

        Raises:
            InputError: Two drives of a bus share a node id, or one has no ranges.
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
        self.error = self.words[codec.W_ERROR]
        self.temperature = self.words[codec.W_TEMPERATURE]
        self.sent: F64 = np.zeros(n)
        self.code: I64 = np.zeros(n, dtype=np.int64)
        self.other = np.zeros(_CAPACITY, dtype=np.uint8)
        self.goal = GOAL_OFF
        self._asked = self.words[codec.W_ASKED]
        self._after = self.words[codec.W_AFTER]
        self._scale = ScaleTable.of(scales).values
        self._wire = wire_table(scales)
        self._host_id = scales[0].host_id
        self._node_ids = np.array([drive.node_id for drive in drives], dtype=np.int64)
        self._members = [
            np.array([i for i, drive in enumerate(drives) if drive.bus == bus], dtype=np.int64)
            for bus in range(buses)
        ]
        self._lookups = [np.full(256, -1, dtype=np.int32) for _ in range(buses)]
        for members, lookup in zip(self._members, self._lookups, strict=True):
            ids = self._node_ids[members].tolist()
            if len(set(ids)) != len(ids):
                raise InputError("drives", f"node ids {ids} on one bus", "all different")
            lookup[ids] = members
        self._compile()

    def _compile(self) -> None:
        """Call every kernel on frames that change nothing."""
        out = np.zeros((len(self.q), 16), dtype=np.uint8)
        self.command(np.zeros_like(self.q))
        for bus in range(len(self._members)):
            self.sync(bus, out)
            self.decode(bus, out, 0)
            self.missing(bus)

    def start(self, found: SetUp) -> None:
        """Begin from the states and positions that set-up read; the first torque is zero."""
        self.words[:] = 0
        self.status[:] = found.statusword
        self.words[codec.W_CODE] = found.counts
        self.code[:] = codec.T_ZERO
        self.sent[:] = 0.0
        for i, code in enumerate(found.counts):
            self.q[i] = codec.position_of(code, self._wire, i)
        self.v[:] = 0.0

    def begin(self) -> None:
        """Begin a cycle: no answer has been seen yet."""
        self.seen[:] = 0

    def sync(self, bus: int, out: Frames, row: int = 0) -> int:
        """Fill in, from ``row`` on, what the last cycle has for each drive of one bus."""
        rows: int = codec.encode_cycle(
            out, row, self._members[bus], self._node_ids, self._asked, self.code
        )
        return rows

    def decode(self, bus: int, frames: Frames, count: int) -> int:
        """Take in frames of one bus; return how many rows ``other`` marks."""
        marked: int = codec.decode_answers(
            frames, count, self._host_id, self._lookups[bus], self._wire, self.values,
            self.words, self.other,
        )  # fmt: skip
        return marked

    def missing(self, bus: int) -> int:
        """Return how many joints of one bus have not answered in this cycle."""
        count: int = _missing(self.seen, self._members[bus])
        return count

    def command(self, tau: F64) -> None:
        """Limit and quantise the torques of all joints, (n,), Nm, for the next tick."""
        steer(self.goal, self.status, self._asked, self._after)
        quantise(tau, self._scale, self._asked, self.code, self.sent)

    def encode(self, bus: int, out: Frames) -> int:
        """Send nothing: the commands go out at the next tick."""
        return 0
