"""Rows of the per-joint record that every law reads and writes once per cycle.

The record is a matrix ``rec`` of shape ``(len(NAMES), n)``, float64, one column
per joint; it is the per-joint part of the ``/cycle`` message, so what is logged is
what was computed, without a copy. Columns are joints: code that touches only
column ``i`` is local to joint ``i``.

Verdicts are stored as float64 with the values of :data:`VERDICTS`.
"""

from __future__ import annotations

from typing import Final

Q: Final = 0  # measured position, rad (m for a prismatic joint)
V: Final = 1  # measured velocity, rad/s
QD: Final = 2  # desired position, rad
VD: Final = 3  # desired velocity, rad/s
AD: Final = 4  # desired acceleration, rad/s^2
TAU_LAW: Final = 5  # torque of the law before the gain (33), Nm
TAU_CMD: Final = 6  # torque as sent: after gain, saturation and quantisation, Nm
RHO_HAT: Final = 7  # estimated effectiveness, in [0, 1.2]; NaN for laws without one
RHO_STD: Final = 8  # its standard deviation; NaN for laws without one
OBSERVABLE: Final = 9  # 1 while rho can be observed, else 0
VERDICT: Final = 10  # see VERDICTS
S: Final = 11  # sliding variable s of eq. (4), rad/s
RESIDUAL: Final = 12  # torque missing against the healthy model, Nm
AGE: Final = 13  # age of the measurement, cycles (0: answered this cycle)
STATUS: Final = 14  # CiA 402 statusword of the drive; of the executor, no law reads it

NAMES: Final = (
    "q", "v", "qd", "vd", "ad", "tau_law", "tau_cmd", "rho_hat", "rho_std",
    "observable", "verdict", "s", "residual", "age", "status",
)  # fmt: skip

HEALTHY: Final = 0.0
ACTUATOR_LOSS: Final = 1.0
PAYLOAD_CHANGE: Final = 2.0
DISTURBANCE: Final = 3.0
NOT_OBSERVABLE: Final = 4.0
SENSOR: Final = 5.0
UNKNOWN: Final = 6.0
ANOMALY: Final = 7.0

VERDICTS: Final = {
    0: "healthy",
    1: "actuator loss",
    2: "payload change",
    3: "disturbance or contact",
    4: "not observable",
    5: "sensor",
    6: "unknown",
    7: "anomaly not yet attributed",
}
