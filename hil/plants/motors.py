"""The motors: lag, torque constant, and what the faults leave of the torque.

    command -> lag -> motor (what the drive reports) -> times true over nominal constant
            -> further lag -> dead zone -> saturation -> times rho -> plus bias -> applied

A stuck motor goes on giving what came out when it got stuck. The effectiveness that is logged
holds what a dead zone and a saturation let through at this instant, and is 0 for a stuck motor,
which follows nothing.

Source: [zhao2017] eq. (2).
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from hil.faults import effectiveness, effects
from hil.plants.layout import (
    APPLIED,
    BIAS,
    CEILING,
    COMMAND,
    DEAD_ZONE,
    FAULT,
    HELD,
    HOLDING,
    LAG,
    LAGGED,
    MOTOR,
    RHO,
    STUCK,
    TORQUE_CONSTANT,
)

F64 = NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _share(torque: float, dead_zone: float, ceiling: float) -> float:
    """Share of a torque that comes through a dead zone and then a saturation, in [0, 1]."""
    size = abs(torque)
    if size <= dead_zone:
        return 0.0 if dead_zone > 0.0 else 1.0
    return min(size - dead_zone, ceiling) / size


@numba.njit(cache=True, error_model="numpy")
def _faulty(i: int, torque: float, dt: float, rows: F64) -> float:
    """Torque that joint ``i``'s motor gives, told to give ``torque``."""
    lag = rows[LAG, i]
    if lag > 0.0:
        rows[LAGGED, i] -= np.expm1(-dt / lag) * (torque - rows[LAGGED, i])
    else:
        rows[LAGGED, i] = torque
    rows[RHO, i] *= _share(rows[LAGGED, i], rows[DEAD_ZONE, i], rows[CEILING, i])
    given: float = rows[RHO, i] * rows[LAGGED, i]
    if rows[BIAS, i] != 0.0:
        given += rows[BIAS, i]
    if rows[STUCK, i] == 0.0:
        rows[HOLDING, i] = 0.0
        return given
    if rows[HOLDING, i] == 0.0:
        rows[HOLDING, i] = 1.0
        rows[HELD, i] = rows[APPLIED, i]  # of the substep before
    rows[RHO, i] = 0.0
    held: float = rows[HELD, i]
    return held


@numba.njit(cache=True, error_model="numpy")
def drive(
    t: float, dt: float, alpha: float, faults: NDArray[np.void], joints: F64, rows: F64
) -> None:
    """Bring the motors' torque to the substep that begins at ``t``. Real-time safe.

    Args:
        t: Rig time, s.
        dt: Substep, s.
        alpha: Share of the way to the command that the drive's lag allows in a substep.
        faults: From :func:`hil.faults.compile_faults`.
        joints: Parameters of the joints, (N_PARAMETERS, n).
        rows: State, (N_STATE, n); COMMAND is read, all up to FRICTION is written.
    """
    effectiveness(t, faults, rows[RHO], rows[FAULT])
    faulty = faults.shape[0] > 0
    if faulty:
        effects(t, faults, joints, rows)
    for i in range(rows.shape[1]):
        rows[MOTOR, i] += alpha * (rows[COMMAND, i] - rows[MOTOR, i])
        torque = joints[TORQUE_CONSTANT, i] * rows[MOTOR, i]
        if faulty:
            torque = _faulty(i, torque, dt, rows)
        rows[APPLIED, i] = torque


@numba.njit(cache=True, error_model="numpy")
def reveal(t: float, faults: NDArray[np.void], joints: F64, rows: F64) -> None:
    """Bring RHO and FAULT up to rig time ``t``, s, the torque as it is, and nothing else."""
    effectiveness(t, faults, rows[RHO], rows[FAULT])
    if faults.shape[0] > 0:
        effects(t, faults, joints, rows)
        for i in range(rows.shape[1]):
            through = _share(rows[LAGGED, i], rows[DEAD_ZONE, i], rows[CEILING, i])
            rows[RHO, i] *= 0.0 if rows[STUCK, i] != 0.0 else through
