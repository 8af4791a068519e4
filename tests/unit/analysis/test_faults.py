"""Faults out of the attached scenario."""

from __future__ import annotations

from typing import get_args

import pytest

from dftc_rt.analysis.faults import (
    ACTUATOR_KINDS,
    FaultSpec,
    actuator_faults,
    faults_of,
    scenario_of,
)
from dftc_rt.config.faults import Fault, OnBus
from dftc_rt.config.load import load_scenario
from dftc_rt.errors import LogError
from hil import SCENARIOS

from .conftest import Maker


def test_faults_of_a_resolved_scenario(make: Maker) -> None:
    text = load_scenario(
        SCENARIOS / "panda_shoulder_loss.toml",
        ['fault=[{joint="panda_joint2", kind="ramp", to=0.5, over_s=3.0, start_s=2.0},'
         '{joint="panda_joint4", kind="total", start_s=7.0, end_s=8.0}]'],
    ).text  # fmt: skip
    assert faults_of(scenario_of(make(text))) == (
        FaultSpec("panda_joint2", "ramp", 2.0, 1e9, 0.5),
        FaultSpec("panda_joint4", "total", 7.0, 8.0, 0.0),
    )


def test_faults_of_the_whole_arm_have_no_joint(make: Maker) -> None:
    text = load_scenario(
        SCENARIOS / "panda_shoulder_loss.toml",
        ['fault=[{kind="payload", payload_kg=1.0, start_s=2.0},'
         '{kind="contact", joint="panda_joint4", force_n=[0.0, 0.0, -20.0], end_s=8.0},'
         '{kind="friction", factor=1.5}, {kind="bias", joint="panda_joint1", torque_nm=2.0}]'],
    ).text  # fmt: skip
    found = faults_of(scenario_of(make(text)))
    assert found == (
        FaultSpec("", "payload", 2.0),
        FaultSpec("panda_joint4", "contact", 0.0, 8.0),
        FaultSpec("", "friction", 0.0),
        FaultSpec("panda_joint1", "bias", 0.0),
    )
    assert actuator_faults(found) == found[3:]


def test_every_kind_is_an_actuators_or_not() -> None:
    faults = [fault for fault in get_args(Fault) if not issubclass(fault, OnBus)]
    kinds = {fault.__struct_config__.tag for fault in faults}
    assert kinds - ACTUATOR_KINDS == {
        "payload", "contact", "friction", "emcy", "silent", "late", "restart",
        "sensor_bias", "sensor_frozen", "sensor_noise", "sensor_bits",
    }  # fmt: skip


def test_no_scenario_no_faults(make: Maker) -> None:
    assert faults_of(scenario_of(make())) == ()


def test_a_damaged_scenario_is_one_line(make: Maker) -> None:
    with pytest.raises(LogError, match=r"scenario\.toml"):
        scenario_of(make("= 1"))
    with pytest.raises(LogError, match=r"fault\[0\]"):
        faults_of(scenario_of(make('[[fault]]\njoint = "a"\n')))
