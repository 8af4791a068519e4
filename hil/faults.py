"""Faults of the rig, over rig time: what they do to each joint's motor and friction.

``payload`` and ``contact`` act on the arm as a whole (:mod:`hil.plants.outside`), others on a drive
as a node (:mod:`hil.drive.failures`) or on its encoder (:mod:`hil.drive.sensor_faults`); here they
are only known to be active.

Source: fault models of [zhao2017] section 2 (eq. (2)) and docs/faults.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt import effectiveness as shares
from dftc_rt.config import faults as kinds
from dftc_rt.config.faults import Fault
from dftc_rt.errors import InputError
from hil.plants.layout import BIAS, CEILING, DEAD_ZONE, FRICTION, LAG, STUCK, TORQUE_LIMIT

F64 = NDArray[np.float64]

_BIAS, _SATURATION, _DEAD_ZONE, _STUCK_TORQUE, _LAG, _FRICTION = range(shares.LAST + 1, 10)
LOCK: Final = 10
_IN_DRIVE: Final = 11
PAYLOAD: Final = 12
CONTACT: Final = 13
_EVERY_JOINT: Final = -1

_FAULT = np.dtype(
    [
        ("joint", np.int64),
        ("profile", np.int64),
        ("start", np.float64),
        ("end", np.float64),
        ("a", np.float64),
        ("b", np.float64),
        ("c", np.float64),
        ("d", np.float64),
    ],
    align=True,
)


def compile_faults(faults: Sequence[Fault], joints: Sequence[str]) -> NDArray[np.void]:
    """Return the faults of joints and arm as a structured array for the kernels, one row each.

    Those of buses are left out: :mod:`hil.bus.impairments` has them.

    Raises:
        InputError: A fault names an unknown joint, or ends before it starts.
    """
    own = [(k, fault) for k, fault in enumerate(faults) if not isinstance(fault, kinds.OnBus)]
    table = np.zeros(len(own), dtype=_FAULT)
    for row, (k, fault) in zip(table, own, strict=True):
        if fault.joint is not None and fault.joint not in joints:
            raise InputError(
                f"fault[{k}].joint", f"no joint '{fault.joint}'", "one of " + ", ".join(joints)
            )
        if fault.end_s <= fault.start_s:
            raise InputError(f"fault[{k}].end_s", f"{fault.end_s}", f"more than {fault.start_s}")
        row["start"], row["end"] = fault.start_s, fault.end_s
        row["profile"], parameters = _parameters(fault)
        for name, value in zip("abcd", parameters, strict=False):
            row[name] = value
        if fault.joint is not None:
            row["joint"] = joints.index(fault.joint)
        else:
            row["joint"] = _EVERY_JOINT if row["profile"] == _FRICTION else len(joints) - 1
    return table


def _parameters(fault: Fault) -> tuple[int, tuple[float, ...]]:
    share = shares.profile(fault)
    if share is not None:
        return share
    match fault:
        case kinds.BiasFault():
            return _BIAS, (fault.torque_nm,)
        case kinds.SaturationFault():
            return _SATURATION, (fault.limit,)
        case kinds.DeadZoneFault():
            return _DEAD_ZONE, (fault.width_nm,)
        case kinds.StuckTorqueFault():
            return _STUCK_TORQUE, ()
        case kinds.LagFault():
            return _LAG, (fault.lag_s,)
        case kinds.FrictionFault():
            return _FRICTION, (fault.factor,)
        case kinds.LockFault():
            return LOCK, ()
        case (
            kinds.EmcyFault()
            | kinds.SilentFault()
            | kinds.LateFault()
            | kinds.RestartFault()
            | kinds.SensorBiasFault()
            | kinds.SensorFrozenFault()
            | kinds.SensorNoiseFault()
            | kinds.SensorBitsFault()
        ):
            return _IN_DRIVE, ()
        case kinds.PayloadFault():
            return PAYLOAD, (fault.payload_kg, *fault.com_m)
        case kinds.ContactFault():
            return CONTACT, fault.force_n
    raise AssertionError(fault)  # the union has no other kind


@numba.njit(cache=True)
def effectiveness(t: float, faults: NDArray[np.void], rho: F64, active: F64) -> None:
    """Write effectiveness and whether a fault is active, per joint, at rig time ``t``.

    Several faults on one joint multiply. Kinds that take no share of the torque leave it at 1;
    what a dead zone, a saturation or a stuck motor make of it depends on the torque
    (:mod:`hil.plants.motors`).

    Args:
        t: Rig time, s.
        faults: From :func:`compile_faults`.
        rho: Out, (n,), in [0, 1].
        active: Out, (n,), 1.0 while a fault of the joint, or of the arm as a whole, is active.
    """
    for i in range(rho.shape[0]):
        rho[i] = 1.0
        active[i] = 0.0
    for k in range(faults.shape[0]):
        f = faults[k]
        if t < f.start or t >= f.end:
            continue
        if f.profile >= PAYLOAD or f.joint == _EVERY_JOINT:
            active[:] = 1.0
        else:
            active[f.joint] = 1.0
        if f.profile <= shares.LAST:
            rho[f.joint] *= shares.value(f.profile, t, f.start, f.a, f.b, f.c)
        elif f.profile == LOCK:
            rho[f.joint] = 0.0


@numba.njit(cache=True)
def effects(t: float, faults: NDArray[np.void], joints: F64, rows: F64) -> None:
    """Write what the faults of the other kinds do to motors and friction at rig time ``t``.

    Of several on one joint, biases and lags add, factors of friction multiply, and of dead
    zones and saturations the most severe holds.

    Args:
        t: Rig time, s.
        faults: From :func:`compile_faults`.
        joints: Parameters of the joints, (N_PARAMETERS, n).
        rows: State, (N_STATE, n); writes BIAS to FRICTION.
    """
    rows[BIAS, :] = 0.0
    rows[CEILING, :] = np.inf
    rows[DEAD_ZONE, :] = 0.0
    rows[LAG, :] = 0.0
    rows[STUCK, :] = 0.0
    rows[FRICTION, :] = 1.0
    for k in range(faults.shape[0]):
        f = faults[k]
        if t < f.start or t >= f.end:
            continue
        i = f.joint
        if f.profile == _BIAS:
            rows[BIAS, i] += f.a
        elif f.profile == _SATURATION:
            rows[CEILING, i] = min(rows[CEILING, i], f.a * joints[TORQUE_LIMIT, i])
        elif f.profile == _DEAD_ZONE:
            rows[DEAD_ZONE, i] = max(rows[DEAD_ZONE, i], f.a)
        elif f.profile == _STUCK_TORQUE:
            rows[STUCK, i] = 1.0
        elif f.profile == _LAG:
            rows[LAG, i] += f.a
        elif f.profile == _FRICTION:
            if i == _EVERY_JOINT:
                rows[FRICTION, :] *= f.a
            else:
                rows[FRICTION, i] *= f.a
