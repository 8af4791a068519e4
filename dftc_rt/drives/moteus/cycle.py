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

from dftc_rt.bus.frame import FD_FRAME_SIZE, Frames
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import GOAL_OPERATE, GOAL_READY, DriveConfig, SetUp
from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus.scale import TIMEOUT_STEP, scales_of, wire_table
from dftc_rt.drives.polled_cycle import PolledCycle
from dftc_rt.drives.scale import quantise_torque
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

COUNTS_PER_REV: Final = 1 << 24  # of the positions that set-up hands over
_NODES: Final = 128  # of 7 bits

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


class MoteusCycle(PolledCycle):
    """Feedback and commands of all drives of a robot.

    Attributes, besides those of :class:`PolledCycle`:
        mode: Modes of the last answers, (n,).
        fault: Fault codes, (n,), of the last answers that had one.
    """

    def __init__(self, drives: Sequence[DriveConfig], buses: int, rate_hz: float) -> None:
        """Allocate everything and compile the kernels.

        Args:
            drives: The drives, in joint order, with ``MoteusScale``.
            buses: Number of buses.
            rate_hz: Cycles per second.

        Raises:
            InputError: Two drives of a bus share a node id, one is of another profile, or
                its watchdog would fire between two commands.
        """
        n = len(drives)
        scales = scales_of(drives)
        self.words: I64 = np.zeros((codec.W_ROWS, n), dtype=np.int64)
        super().__init__(
            drives, scales, buses, np.zeros((codec.F_ROWS, n)), self.words[codec.W_SEEN],
            self.words[codec.W_STATUS], _NODES,
        )  # fmt: skip
        self.mode = self.words[codec.W_MODE]
        self.fault = self.words[codec.W_FAULT]
        self.counts: I64 = np.zeros(n, dtype=np.int64)
        self._asked = self.words[codec.W_ASKED]
        self._after = self.words[codec.W_AFTER]
        self._found: F64 = np.zeros(5)
        self._wire = wire_table(scales)
        self._timeout = scales[0].timeout
        if 0 < self._timeout * TIMEOUT_STEP <= 1.0 / rate_hz:
            raise InputError(
                "bus.moteus.watchdog_s",
                f"{self._timeout * TIMEOUT_STEP:g} s at {rate_hz:g} Hz",
                "more than the time from one command to the next",
            )
        self._compile(FD_FRAME_SIZE)

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

    def command(self, tau: F64) -> None:
        """Limit and quantise the torques of all joints, (n,), Nm, for the next tick."""
        steer(self.goal, self.status, self._asked, self._after)
        quantise_torque(tau, self._scale, self.counts, self.sent)
        if self.goal != GOAL_OPERATE:
            self.sent[:] = 0.0
        _only_enabled(self.status, self.counts, self.sent)
