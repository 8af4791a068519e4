"""Actuator faults of the rig: effectiveness of every joint as a function of rig time.

Source: fault models of [zhao2017] section 2 (eq. (2)) and docs/faults.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import (
    Fault,
    IntermittentFault,
    LossFault,
    RampFault,
    SineFault,
)
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]

_CONSTANT, _RAMP, _SINE, _INTERMITTENT = range(4)

_FAULT = np.dtype(
    [
        ("joint", np.int64),
        ("profile", np.int64),
        ("start", np.float64),
        ("end", np.float64),
        ("a", np.float64),
        ("b", np.float64),
        ("c", np.float64),
    ],
    align=True,
)


def compile_faults(faults: Sequence[Fault], joints: Sequence[str]) -> NDArray[np.void]:
    """Return the faults as a structured array for :func:`effectiveness`.

    Raises:
        InputError: A fault names an unknown joint, or ends before it starts.
    """
    table = np.zeros(len(faults), dtype=_FAULT)
    for k, fault in enumerate(faults):
        if fault.joint not in joints:
            raise InputError(
                f"fault[{k}].joint", f"no joint '{fault.joint}'", "one of " + ", ".join(joints)
            )
        if fault.end_s <= fault.start_s:
            raise InputError(f"fault[{k}].end_s", f"{fault.end_s}", f"more than {fault.start_s}")
        row = table[k]
        row["joint"] = joints.index(fault.joint)
        row["start"], row["end"] = fault.start_s, fault.end_s
        row["profile"], (row["a"], row["b"], row["c"]) = _parameters(fault)
    return table


def _parameters(fault: Fault) -> tuple[int, tuple[float, float, float]]:
    if isinstance(fault, LossFault):
        return _CONSTANT, (fault.effectiveness, 0.0, 0.0)
    if isinstance(fault, RampFault):
        return _RAMP, (fault.to, fault.over_s, 0.0)
    if isinstance(fault, SineFault):
        return _SINE, (fault.mean, fault.amplitude, fault.omega_rad_s)
    if isinstance(fault, IntermittentFault):
        return _INTERMITTENT, (fault.effectiveness, fault.period_s, fault.duty)
    return _CONSTANT, (0.0, 0.0, 0.0)


@numba.njit(cache=True)
def effectiveness(t: float, faults: NDArray[np.void], rho: F64, active: F64) -> None:
    """Write effectiveness and whether a fault is active, per joint, at rig time ``t``.

    Several faults on one joint multiply.

    Args:
        t: Rig time, s.
        faults: From :func:`compile_faults`.
        rho: Out, (n,), in [0, 1].
        active: Out, (n,), 1.0 while a fault of the joint is active.
    """
    for i in range(rho.shape[0]):
        rho[i] = 1.0
        active[i] = 0.0
    for k in range(faults.shape[0]):
        f = faults[k]
        if t < f.start or t >= f.end:
            continue
        if f.profile == _CONSTANT:
            value = f.a
        elif f.profile == _RAMP:
            value = 1.0 + (f.a - 1.0) * min((t - f.start) / f.b, 1.0)
        elif f.profile == _SINE:
            value = min(max(f.a + f.b * np.cos(f.c * t), 0.0), 1.0)
        else:
            phase = ((t - f.start) / f.b) % 1.0
            value = f.a if phase < f.c else 1.0
        rho[f.joint] *= value
        active[f.joint] = 1.0
