"""The start-up probe: a small torque on each joint alone, and whether it moves that way.

A drive whose encoder counts against its torque (a swapped motor phase, a wrong polarity) makes of
every feedback law one that drives the joint away. The probe finds that before the arm is
asked to move.

On top of what holds the pose a joint gets ``probe`` of its torque limit for ``PUSH_S``, then the
same the other way, which takes the speed away again; then the next joint. Half the difference of
the speeds gained is compared with what that torque gives the joint's own inertia: gravity, and a
hold that is none because its torque acts the wrong way, are in both and fall out.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.control import signals

F64 = NDArray[np.float64]

STILL_S: Final = 0.005  # before each push, for the speed to compare with
PUSH_S: Final = 0.01
FARTHEST_RAD: Final = 0.005  # a push ends there
_LEAST: Final = 0.2  # of the speed that the torque gives the inertia alone: an answer


class Finding(IntEnum):
    """What the probe knows."""

    UNDER_WAY = 0
    RIGHT = 1  # of every joint
    AGAINST = 2
    SILENT = 3


class SignProbe:
    """Probes the joints one after the other; one object a run. Real-time safe.

    Attributes:
        joint: The joint that is probed, or of which a fault was found.
        finding: What is known.
    """

    def __init__(self, fraction: float, torque_limit: F64, period_s: float) -> None:
        """Begin with the first joint.

        Args:
            fraction: Torque of a push, of the joint's limit.
            torque_limit: (n,), Nm.
            period_s: Control period, s.
        """
        self.push = fraction * torque_limit
        self.joint = 0
        self.finding = Finding.UNDER_WAY
        self._limit = torque_limit
        self._period = period_s
        self._still = max(round(STILL_S / period_s), 2)
        self._push = max(round(PUSH_S / period_s), 4)
        self._cycle = 0  # of this joint
        self._ended = 0  # cycle at which the push ended, 0 while it has not
        self._speed = 0.0  # before the push
        self._top = 0.0  # at its end
        self._q0 = 0.0

    def step(self, rec: F64, inertia: F64) -> None:
        """Look at the measurement of one cycle, and add the push to its torque.

        Args:
            rec: The cycle's record, (15, n): q, v and what holds the pose; TAU_CMD is changed.
            inertia: Inertia that each joint sees, (n,), kg m².
        """
        i, k = self.joint, self._cycle
        q, v = rec[signals.Q, i], rec[signals.V, i]
        self._cycle += 1
        if k < self._still:
            self._speed = v if k == 0 else self._speed + (v - self._speed) / (k + 1)
            self._q0 = q
            return
        pushed = k - self._still
        if not self._ended:
            if pushed < self._push and abs(q - self._q0) < FARTHEST_RAD:
                self._add(rec, i, self.push[i])
                return
            self._ended = max(pushed, 1)
            self._top = v
        if pushed < 2 * self._ended:
            self._add(rec, i, -self.push[i])
        elif pushed == 2 * self._ended:
            self._judge(v, inertia[i])
        elif pushed >= 3 * self._ended:  # it has come to rest
            self._next()

    def _judge(self, v: float, inertia: float) -> None:
        """Compare what both pushes did: whatever else accelerates the joint is in both."""
        gained = 0.5 * ((self._top - self._speed) - (v - self._top))
        expected = self.push[self.joint] * self._ended * self._period / inertia
        if abs(gained) < _LEAST * expected:
            self.finding = Finding.SILENT
        elif gained < 0.0:
            self.finding = Finding.AGAINST

    def _next(self) -> None:
        self._cycle = self._ended = 0
        if self.joint + 1 == self.push.shape[0]:
            self.finding = Finding.RIGHT
        else:
            self.joint += 1

    def _add(self, rec: F64, i: int, torque: float) -> None:
        limit = self._limit[i]
        rec[signals.TAU_CMD, i] = min(max(rec[signals.TAU_CMD, i] + torque, -limit), limit)

    def reason(self, name: str) -> str:
        """Return a fault that was found as a line for people."""
        torque = f"{self.push[self.joint]:.3g} Nm"
        if self.finding is Finding.AGAINST:
            return f"{name}: moves against its torque of {torque}: drive polarity or motor phases"
        return f"{name}: no response to {torque}: stuck, or supervisor.probe is too small"
