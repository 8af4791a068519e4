"""Effectiveness ρ over time, for the kinds of fault that take a share of a motor's torque.

The rig applies it to the torque (:mod:`hil.faults`); of the controller, the law ``oracle`` alone
is told it.

Source: [zhao2017] eq. (2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config import faults as kinds
from dftc_rt.config.faults import Fault
from dftc_rt.errors import InputError

F64 = NDArray[np.float64]

CONSTANT, RAMP, SINE, INTERMITTENT = range(4)

LAST: Final = INTERMITTENT
"""Highest profile of an effectiveness; the rig numbers other effects on from here."""


def profile(fault: Fault) -> tuple[int, tuple[float, ...]] | None:
    """Profile and parameters of a fault's ρ; None when it takes no share of the torque."""
    match fault:
        case kinds.LossFault():
            return CONSTANT, (fault.effectiveness,)
        case kinds.RampFault():
            return RAMP, (fault.to, fault.over_s)
        case kinds.SineFault():
            return SINE, (fault.mean, fault.amplitude, fault.omega_rad_s)
        case kinds.IntermittentFault():
            return INTERMITTENT, (fault.effectiveness, fault.period_s, fault.duty)
        case kinds.TotalFault():
            return CONSTANT, (0.0,)
    return None


@numba.njit(cache=True)
def value(which: int, t: float, start: float, a: float, b: float, c: float) -> float:
    """ρ of one fault that is active at ``t``, in [0, 1].

    Args:
        which: Profile.
        t: Time since the run began, s.
        start: Start of the fault, s.
        a: First parameter of :func:`profile`; b and c the others, 0 where there are fewer.
        b: Second.
        c: Third.
    """
    if which == CONSTANT:
        return a
    if which == RAMP:
        return 1.0 + (a - 1.0) * min((t - start) / b, 1.0)
    if which == SINE:
        wave: float = a + b * np.cos(c * t)
        return min(max(wave, 0.0), 1.0)
    return a if ((t - start) / b) % 1.0 < c else 1.0


def schedule(faults: Sequence[Fault], joints: Sequence[str]) -> Callable[[float, F64], None]:
    """Return a function (t, out) that writes ρ of every joint at ``t`` seconds to ``out`` (n,).

    Several faults on one joint multiply.

    Raises:
        InputError: A fault names an unknown joint.
    """
    rows = []
    for k, fault in enumerate(faults):
        found = profile(fault)
        if found is None or isinstance(fault, kinds.OnBus):
            continue
        if fault.joint is None or fault.joint not in joints:
            expected = "one of " + ", ".join(joints)
            raise InputError(f"fault[{k}].joint", f"no joint '{fault.joint}'", expected)
        which, parameters = found
        a, b, c = (*parameters, 0.0, 0.0)[:3]
        rows.append((joints.index(fault.joint), fault.start_s, fault.end_s, which, a, b, c))

    def write(t: float, out: F64) -> None:
        out.fill(1.0)
        for joint, start, end, which, a, b, c in rows:
            if start <= t < end:
                out[joint] *= value(which, t, start, a, b, c)

    return write
