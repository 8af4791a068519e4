"""Effectiveness over time, one test a profile, against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.config.faults import (
    BiasFault,
    ContactFault,
    EmcyFault,
    Fault,
    FrictionFault,
    IntermittentFault,
    LateFault,
    LockFault,
    LossFault,
    PayloadFault,
    RampFault,
    RestartFault,
    SensorBiasFault,
    SensorBitsFault,
    SensorFrozenFault,
    SensorNoiseFault,
    SilentFault,
    SineFault,
    TotalFault,
)
from dftc_rt.errors import InputError
from hil.faults import compile_faults, effectiveness

JOINTS = ("a", "b")


def _rho(fault: Fault, t: float) -> float:
    rho, active = np.empty(2), np.empty(2)
    effectiveness(t, compile_faults([fault], JOINTS), rho, active)
    assert rho[0] == 1.0
    assert active[0] == 0.0
    assert active[1] == float(fault.start_s <= t < fault.end_s)
    return float(rho[1])


def test_loss_lasts_from_start_to_end() -> None:
    fault = LossFault(joint="b", start_s=1.0, end_s=2.0, effectiveness=0.6)
    assert [_rho(fault, t) for t in (0.999, 1.0, 1.999, 2.0)] == [1.0, 0.6, 0.6, 1.0]


def test_ramp_falls_linearly_and_stays() -> None:
    fault = RampFault(joint="b", start_s=1.0, to=0.5, over_s=2.0)
    assert [_rho(fault, t) for t in (1.0, 2.0, 3.0, 9.0)] == [1.0, 0.75, 0.5, 0.5]


def test_sine_is_the_papers() -> None:
    fault = SineFault(joint="b", start_s=20.0, mean=0.8, amplitude=0.2, omega_rad_s=3.0)
    assert _rho(fault, 21.3) == pytest.approx(0.8 + 0.2 * np.cos(3 * 21.3))


def test_intermittent_comes_and_goes() -> None:
    fault = IntermittentFault(joint="b", start_s=1.0, effectiveness=0.4, period_s=1.0, duty=0.25)
    assert [_rho(fault, t) for t in (1.0, 1.2, 1.3, 1.9, 2.1)] == [0.4, 0.4, 1.0, 1.0, 0.4]


def test_total_loss_leaves_nothing() -> None:
    assert _rho(TotalFault(joint="b", start_s=1.0), 1.5) == 0.0


def test_two_faults_on_one_joint_multiply() -> None:
    faults = [LossFault(joint="a", effectiveness=e) for e in (0.5, 0.8)]
    rho, active = np.empty(2), np.empty(2)
    effectiveness(0.0, compile_faults(faults, JOINTS), rho, active)
    np.testing.assert_allclose(rho, [0.4, 1.0])


@pytest.mark.parametrize(
    ("fault", "joints"),
    [
        (BiasFault(joint="b", torque_nm=1.0), [0.0, 1.0]),
        (PayloadFault(payload_kg=1.0), [1.0, 1.0]),
        (PayloadFault(joint="a", payload_kg=1.0), [1.0, 1.0]),
        (ContactFault(force_n=(0.0, 0.0, -1.0)), [1.0, 1.0]),
        (FrictionFault(factor=1.5), [1.0, 1.0]),
        (FrictionFault(joint="a", factor=1.5), [1.0, 0.0]),
    ],
)
def test_active_is_said_of_every_joint_that_it_concerns(fault: Fault, joints: list[float]) -> None:
    rho, active = np.empty(2), np.empty(2)
    effectiveness(5.0, compile_faults([fault], JOINTS), rho, active)
    assert active.tolist() == joints
    assert rho.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("fault", "where"),
    [
        (PayloadFault(joint="c", payload_kg=1.0), "fault[0].joint"),
        (TotalFault(joint="c"), "fault[0].joint"),
        (TotalFault(joint="a", start_s=3.0, end_s=2.0), "fault[0].end_s"),
    ],
)
def test_bad_faults_are_refused(fault: Fault, where: str) -> None:
    with pytest.raises(InputError) as caught:
        compile_faults([fault], JOINTS)
    assert caught.value.where == where


@pytest.mark.parametrize(
    "fault",
    [
        EmcyFault(joint="b", start_s=1.0, end_s=2.0, error_code=0x5000),
        SilentFault(joint="b", start_s=1.0, end_s=2.0),
        LateFault(joint="b", start_s=1.0, end_s=2.0, delay_s=0.01),
        RestartFault(joint="b", start_s=1.0, boot_s=1.0),
        SensorBiasFault(joint="b", start_s=1.0, end_s=2.0, bias_rad=0.1),
        SensorFrozenFault(joint="b", start_s=1.0, end_s=2.0),
        SensorNoiseFault(joint="b", start_s=1.0, end_s=2.0),
        SensorBitsFault(joint="b", start_s=1.0, end_s=2.0, bits=4),
    ],
)
def test_drives_and_sensors_that_fail_take_no_share_of_the_torque(fault: Fault) -> None:
    assert [_rho(fault, t) for t in (0.999, 1.0, 1.999, 2.0)] == [1.0] * 4


def test_a_locked_joint_has_no_effectiveness() -> None:
    fault = LockFault(joint="b", start_s=1.0, end_s=2.0)
    assert [_rho(fault, t) for t in (0.999, 1.0, 1.999, 2.0)] == [1.0, 0.0, 0.0, 1.0]
