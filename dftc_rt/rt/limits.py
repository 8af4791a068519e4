"""The limits of a run: what they are called, what breaks them, and how the run then stops.

:data:`LIMITS` is the table; docs/safety.md shows the same rows, and a test holds the two
together. The kernel looks at the record of every cycle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import SupervisorTable
from dftc_rt.control import signals

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# What is found. The first one found ends the run; those of a quick stop are looked for first.
OK: Final = 0
NOT_FINITE: Final = 1
DRIVE_FAULT: Final = 2
STALE: Final = 3
TRACKING: Final = 4
RHO_LOW: Final = 5
SATURATED: Final = 6
RUNAWAY: Final = 7
NOT_ENABLED: Final = 8
EMERGENCY: Final = 9
TORQUE: Final = 10
LAW_RAISED: Final = 11
MOVED: Final = 12
OVERSPEED: Final = 13
POSITION: Final = 14
VELOCITY: Final = 15
TORQUE_RATE: Final = 16
OVERRUNS: Final = 17
OVERRUN: Final = 18

RATE_CYCLES: Final = 10  # one step is no oscillation: a reference may begin with one
MOVED_RAD: Final = 0.05  # a closed brake gives by less
_TORQUE_SLACK: Final = 1.0 + 1e-9

_STATUS_FAULT = 0x0008  # CiA 402 statusword, bit 3
_STATE_MASK = 0x006F  # its bits that spell the state
_ENABLED = 0x0027


@dataclass(frozen=True, slots=True)
class Limit:
    """One limit.

    Attributes:
        violation: What :func:`find` returns.
        condition: When it is broken, as documented.
        reason: What the run says, after the joint; ``{limit}`` is filled in.
        ramp: Whether the arm is then brought to rest under control. Where control cannot do
            that (no feedback, a drive or a law that does not obey, an actuator that is all
            but lost), the drives are quick-stopped.
    """

    violation: int
    condition: str
    reason: str
    ramp: bool = False


LIMITS: Final = (
    Limit(
        NOT_FINITE, "NaN or infinity in a measurement, the reference, or what the law wrote",
        "a value that is not finite",
    ),
    Limit(LAW_RAISED, "the law raises", "the law raised {limit}"),
    Limit(
        TORQUE, "the law asks for more than the joint's torque limit",
        "the law asks for more than {limit} Nm",
    ),
    Limit(DRIVE_FAULT, "statusword: fault", "the drive reports a fault"),
    Limit(
        EMERGENCY, "an EMCY with an error code, whatever the statusword says",
        "the drive sent an emergency",
    ),
    Limit(STALE, "no answer for `stale_cycles`", "no fresh feedback for {limit} cycles"),
    Limit(
        NOT_ENABLED, "a drive leaves operation enabled by itself",
        "the drive left operation enabled",
    ),
    Limit(
        MOVED, f"while arming: the pose is {MOVED_RAD} rad from where set-up found it",
        "moved while its brake was closed",
    ),
    Limit(
        RUNAWAY, "tracking error over twice `tracking_error_rad`",
        "tracking error over {limit} rad",
    ),
    Limit(
        OVERSPEED, "speed over twice `velocity_factor` times the joint's limit",
        "speed over {limit} rad/s",
    ),
    Limit(
        RHO_LOW, "verdict actuator loss with ρ̂ below `rho_min`",
        "estimated effectiveness below {limit}",
    ),
    Limit(
        TRACKING, "tracking error over `tracking_error_rad`", "tracking error over {limit} rad",
        ramp=True,
    ),
    Limit(
        POSITION, "position beyond the joint's limits by more than `position_margin_rad`",
        "position beyond its limits by more than {limit} rad", ramp=True,
    ),
    Limit(
        VELOCITY, "speed over `velocity_factor` times the joint's limit",
        "speed over {limit} rad/s", ramp=True,
    ),
    Limit(
        SATURATED, "torque at its limit for `saturation_s`", "torque saturated for {limit} s",
        ramp=True,
    ),
    Limit(
        TORQUE_RATE,
        f"torque changes by more than `torque_rate_per_s` in {RATE_CYCLES} cycles in a row",
        f"torque changed by more than {{limit}} Nm a cycle, {RATE_CYCLES} cycles in a row",
        ramp=True,
    ),
    Limit(
        OVERRUNS, "`overruns_in_a_row` cycles in a row end after the next tick",
        "{limit} cycles in a row took longer than the period", ramp=True,
    ),
    Limit(
        OVERRUN, "one does, with `executor.overrun = \"stop\"`",
        "overrun: the cycle took longer than its period", ramp=True,
    ),
)  # fmt: skip

BY_VIOLATION: Final = {limit.violation: limit for limit in LIMITS}


@dataclass(frozen=True, slots=True)
class JointLimits:
    """What each joint may do, (n,) each.

    Attributes:
        lower, upper: Position, rad (m).
        velocity: Speed, rad/s (m/s).
        torque: As commands are clipped to, Nm (N).
    """

    lower: F64
    upper: F64
    velocity: F64
    torque: F64

    def rows(self, table: SupervisorTable, period_s: float) -> F64:
        """Return the kernel's matrix, (5, n): what the rows of ``_J_*`` say."""
        return np.array(
            [
                self.lower - table.position_margin_rad,
                self.upper + table.position_margin_rad,
                self.velocity * table.velocity_factor,
                self.torque,
                self.torque * table.torque_rate_per_s * period_s,
            ]
        )


def numbers(table: SupervisorTable, period_s: float) -> F64:
    """Return the kernel's limits that are no joint's, (6,)."""
    return np.array(
        [
            table.tracking_error_rad,
            float(table.stale_cycles),
            table.rho_min,
            max(table.saturation_s / period_s, 1.0),
            float(RATE_CYCLES),
            MOVED_RAD,
        ]
    )


@numba.njit(cache=True)
def first_loss(rec: F64) -> int:
    """Return the first joint whose verdict is an actuator loss, -1 for none. Real-time safe."""
    for i in range(rec.shape[1]):
        if rec[signals.VERDICT, i] == signals.ACTUATOR_LOSS:
            return i
    return -1


@numba.njit(cache=True)
def finite(rec: F64, i: int) -> bool:
    """Whether every value of joint ``i`` is a number that has to be one.

    ρ̂, its deviation and the residual are NaN where a law has none; infinite they may not be.
    """
    for row in range(rec.shape[0]):
        value = rec[row, i]
        if row == signals.RHO_HAT or row == signals.RHO_STD or row == signals.RESIDUAL:
            if row != signals.RHO_STD and np.isinf(value):
                return False
        elif not np.isfinite(value):
            return False
    return True


@numba.njit(cache=True)
def find(
    rec: F64,
    statusword: I64,
    emergency: I64,
    counts: I64,
    before: F64,
    joints: F64,
    limits: F64,
    phase: int,
) -> tuple[int, int]:
    """Return (violation, joint), (OK, -1) when all is well. Real-time safe.

    What cannot be ramped down comes first, whichever joint it is.

    Args:
        rec: The cycle's record, (14, n).
        statusword: CiA 402 statusword of each drive, (n,).
        emergency: Last emergency error code of each drive, (n,); 0: none.
        counts: (2, n), kept up to date: cycles at the torque limit in a row, and cycles in
            which the torque changed too fast.
        before: (n,), kept up to date: torque of the last cycle, Nm; NaN: there was none.
        joints: From :meth:`JointLimits.rows`, (5, n).
        limits: From :func:`numbers`, (6,).
        phase: 0 while arming, 1 while every drive must be enabled.
    """
    found, where = OK, -1
    for i in range(rec.shape[1]):
        tau = rec[signals.TAU_CMD, i]
        error = abs(rec[signals.Q, i] - rec[signals.QD, i])
        speed = abs(rec[signals.V, i])
        if not finite(rec, i):
            return NOT_FINITE, i
        if abs(tau) > joints[3, i] * _TORQUE_SLACK:
            return TORQUE, i
        if statusword[i] & _STATUS_FAULT:
            return DRIVE_FAULT, i
        if emergency[i] != 0:
            return EMERGENCY, i
        if rec[signals.AGE, i] >= limits[1]:
            return STALE, i
        if phase == 1 and statusword[i] & _STATE_MASK != _ENABLED:
            return NOT_ENABLED, i
        if phase == 0 and error > limits[5]:
            return MOVED, i
        if error > 2.0 * limits[0]:
            return RUNAWAY, i
        if speed > 2.0 * joints[2, i]:
            return OVERSPEED, i
        if rec[signals.VERDICT, i] == signals.ACTUATOR_LOSS and rec[signals.RHO_HAT, i] < limits[2]:
            return RHO_LOW, i
        counts[0, i] = counts[0, i] + 1 if abs(tau) >= joints[3, i] else 0
        counts[1, i] = counts[1, i] + 1 if abs(tau - before[i]) > joints[4, i] else 0
        before[i] = tau
    for i in range(rec.shape[1]):
        q = rec[signals.Q, i]
        if abs(q - rec[signals.QD, i]) > limits[0]:
            found, where = TRACKING, i
        elif q < joints[0, i] or q > joints[1, i]:
            found, where = POSITION, i
        elif abs(rec[signals.V, i]) > joints[2, i]:
            found, where = VELOCITY, i
        elif counts[0, i] >= limits[3]:
            found, where = SATURATED, i
        elif counts[1, i] >= limits[4]:
            found, where = TORQUE_RATE, i
        if found != OK:
            return found, where
    return found, where
