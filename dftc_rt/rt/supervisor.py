"""The supervisor: states of a run, and the limits that end it in a safe stop.

    idle -> configure -> arm -> run -> finish          the run reached its duration
                          |      |
                          +------+-> safe stop -> fault

``finish`` and ``safe stop`` bring the arm to rest under control, then hand it to the
brakes. Where control cannot do that any more (no feedback, a drive that faults or drops
out, an actuator that is all but lost, an error that keeps growing), the drives are
quick-stopped instead, at once.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import SupervisorTable
from dftc_rt.control import signals

F64 = NDArray[np.float64]


class State(IntEnum):
    """State of the run, as logged in ``/cycle``."""

    IDLE = 0
    CONFIGURE = 1
    ARM = 2
    RUN = 3
    DEGRADED = 4
    SAFE_STOP = 5
    FAULT = 6
    FINISH = 7


# What check() found. The first one found ends the run.
OK: Final = 0
NOT_FINITE: Final = 1
DRIVE_FAULT: Final = 2
STALE: Final = 3
TRACKING: Final = 4
RHO_LOW: Final = 5
SATURATED: Final = 6
RUNAWAY: Final = 7
NOT_ENABLED: Final = 8

REASONS: Final = {
    NOT_FINITE: "a value that is not finite",
    DRIVE_FAULT: "the drive reports a fault",
    STALE: "no fresh feedback for {limit} cycles",
    TRACKING: "tracking error over {limit} rad",
    RHO_LOW: "estimated effectiveness below {limit}",
    SATURATED: "torque saturated for {limit} s",
    RUNAWAY: "tracking error over {limit} rad",
    NOT_ENABLED: "the drive left operation enabled",
}

# Violations after which the loop cannot bring the arm to rest: no feedback, a drive that
# does not obey, an actuator that is all but lost. The brakes can.
UNCONTROLLED: Final = frozenset({NOT_FINITE, DRIVE_FAULT, NOT_ENABLED, STALE, RUNAWAY, RHO_LOW})

_STATUS_FAULT = 0x0008  # CiA 402 statusword, bit 3
_STATE_MASK = 0x006F  # its bits that spell the state
_ENABLED = 0x0027


@numba.njit(cache=True)
def _check(
    rec: F64,
    statusword: NDArray[np.int64],
    saturated: NDArray[np.int64],
    torque_limit: F64,
    limits: F64,
    moving: bool,
) -> tuple[int, int]:
    """Return (violation, joint); updates ``saturated`` (n,), cycles at the limit in a row.

    What cannot be ramped down comes first, whichever joint it is.
    """
    for i in range(rec.shape[1]):
        for row in (signals.Q, signals.V, signals.QD, signals.VD, signals.TAU_LAW, signals.TAU_CMD):
            if not np.isfinite(rec[row, i]):
                return NOT_FINITE, i
        if statusword[i] & _STATUS_FAULT:
            return DRIVE_FAULT, i
        if rec[signals.AGE, i] >= limits[1]:
            return STALE, i
        if moving and statusword[i] & _STATE_MASK != _ENABLED:
            return NOT_ENABLED, i
        if abs(rec[signals.Q, i] - rec[signals.QD, i]) > 2.0 * limits[0]:
            return RUNAWAY, i
        if rec[signals.VERDICT, i] == signals.ACTUATOR_LOSS and rec[signals.RHO_HAT, i] < limits[2]:
            return RHO_LOW, i
    for i in range(rec.shape[1]):
        if abs(rec[signals.Q, i] - rec[signals.QD, i]) > limits[0]:
            return TRACKING, i
        if abs(rec[signals.TAU_CMD, i]) >= torque_limit[i]:
            saturated[i] += 1
            if saturated[i] >= limits[3]:
                return SATURATED, i
        else:
            saturated[i] = 0
    return OK, -1


class Supervisor:
    """Watches every cycle of a run."""

    def __init__(self, table: SupervisorTable, torque_limit: F64, period_s: float) -> None:
        """Take the limits.

        Args:
            table: The scenario's ``[supervisor]``.
            torque_limit: (n,), Nm, as the commands are clipped to.
            period_s: Control period, s.
        """
        self._table = table
        self._torque_limit = torque_limit
        self._saturated = np.zeros(torque_limit.shape[0], dtype=np.int64)
        self._limits = np.array(
            [
                table.tracking_error_rad,
                float(table.stale_cycles),
                table.rho_min,
                max(table.saturation_s / period_s, 1.0),
            ]
        )

    def check(self, rec: F64, statusword: NDArray[np.int64], moving: bool) -> tuple[int, int]:
        """Return (violation, joint index), (OK, -1) when all is well. Real-time safe.

        Args:
            rec: The cycle's record, (15, n).
            statusword: CiA 402 statusword of each drive, (n,).
            moving: Whether every drive must be in operation enabled.
        """
        found: tuple[int, int] = _check(
            rec, statusword, self._saturated, self._torque_limit, self._limits, moving
        )
        return found

    def reason(self, violation: int, joint: str) -> str:
        """Return the violation as a line for people."""
        table = self._table
        limit = {
            STALE: table.stale_cycles,
            TRACKING: table.tracking_error_rad,
            RUNAWAY: 2.0 * table.tracking_error_rad,
            RHO_LOW: table.rho_min,
            SATURATED: table.saturation_s,
        }.get(violation)
        return f"{joint}: {REASONS[violation].format(limit=limit)}"
