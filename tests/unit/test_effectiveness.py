"""True ρ over time, as the law ``oracle`` is told it: the definition, and what the rig applies."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from dftc_rt.config.faults import (
    BiasFault,
    Fault,
    IntermittentFault,
    LossFault,
    PayloadFault,
    RampFault,
    SineFault,
    TotalFault,
)
from dftc_rt.effectiveness import schedule
from dftc_rt.errors import InputError
from hil.faults import compile_faults, effectiveness

JOINTS = ("a", "b", "c")
LOSS = LossFault(joint="b", start_s=1.0, end_s=3.0, effectiveness=0.6)
RAMP = RampFault(joint="b", start_s=1.0, to=0.4, over_s=2.0)
SINE = SineFault(joint="b", start_s=1.0, mean=0.8, amplitude=0.4, omega_rad_s=3.0)
BLINK = IntermittentFault(joint="b", start_s=1.0, effectiveness=0.5, period_s=0.4, duty=0.25)


def _at(fault: tuple[Fault, ...], t: float) -> np.ndarray:
    out = np.full(len(JOINTS), math.nan)
    schedule(fault, JOINTS)(t, out)
    return out


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (LOSS, lambda t: 0.6 if t < 3.0 else 1.0),
        (RAMP, lambda t: max(1.0 - 0.3 * (t - 1.0), 0.4)),
        (SINE, lambda t: min(max(0.8 + 0.4 * math.cos(3.0 * t), 0.0), 1.0)),
        (BLINK, lambda t: 0.5 if (t - 1.0) % 0.4 < 0.1 else 1.0),
        (TotalFault(joint="b", start_s=1.0), lambda t: 0.0),
        (BiasFault(joint="b", start_s=1.0, torque_nm=3.0), lambda t: 1.0),
        (PayloadFault(start_s=1.0, payload_kg=1.0), lambda t: 1.0),
    ],
)
def test_each_kind_is_its_definition(fault: Fault, expected: Callable[[float], float]) -> None:
    for t in np.arange(0.013, 5.0, 0.17):
        rho = _at((fault,), float(t))
        assert rho[0] == rho[2] == 1.0
        assert rho[1] == pytest.approx(expected(float(t)) if t >= 1.0 else 1.0, abs=1e-12)


def test_faults_on_one_joint_multiply_and_the_rig_agrees() -> None:
    faults = (LOSS, RAMP, SINE, BLINK, LossFault(joint="c", effectiveness=0.9))
    table, rho, active = compile_faults(faults, JOINTS), np.empty(3), np.empty(3)
    for t in np.arange(0.0, 5.0, 0.037):
        effectiveness(float(t), table, rho, active)
        assert np.array_equal(_at(faults, float(t)), rho)
    assert _at((LOSS, RAMP), 2.0)[1] == pytest.approx(0.6 * 0.7)


def test_an_unknown_joint_is_refused() -> None:
    with pytest.raises(InputError, match="no joint 'd'"):
        schedule((LossFault(joint="d", effectiveness=0.5),), JOINTS)
