"""Faults out of the attached scenario."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import msgspec
import pytest

from dftc_rt.analysis.faults import (
    ACTUATOR_KINDS,
    FaultSpec,
    actuator_faults,
    all_faults,
    faults_of,
    scenario_of,
)
from dftc_rt.config.faults import Fault, LossFault, OnBus, PayloadFault
from dftc_rt.config.load import load_scenario
from dftc_rt.errors import LogError
from dftc_rt.fault_socket import fault_table
from dftc_rt.ring import Event
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


def event(t: float, what: str, fault: Fault) -> Event:
    return Event(t, 2, "rig", f"fault {what}: {msgspec.json.encode(fault_table(fault)).decode()}")


def test_faults_applied_at_run_time_are_judged_too(make: Maker) -> None:
    text = load_scenario(
        SCENARIOS / "panda_shoulder_loss.toml",
        ['fault=[{joint="panda_joint2", kind="loss", effectiveness=0.5, start_s=2.0}]'],
    ).text
    first = LossFault(joint="panda_joint4", effectiveness=0.6, start_s=3.0)
    second = LossFault(joint="panda_joint4", effectiveness=0.4, start_s=5.0)
    load = PayloadFault(payload_kg=1.0, start_s=6.0)
    own = LossFault(joint="panda_joint2", effectiveness=0.5, start_s=2.0)
    run = replace(
        make(text),
        events=(
            event(3.0, "applied", first),
            event(5.0, "applied", second),
            event(6.0, "applied", load),
            event(7.0, "cleared", msgspec.structs.replace(own, end_s=7.0)),
            event(8.0, "cleared", msgspec.structs.replace(second, end_s=8.0)),
            Event(8.0, 1, "controller", "fault applied: {"),  # nobody but the rig says so
        ),
    )
    assert all_faults(run, scenario_of(run)) == (
        FaultSpec("panda_joint2", "loss", 2.0, 7.0, 0.5),
        FaultSpec("panda_joint4", "loss", 3.0, 5.0, 0.6),
        FaultSpec("panda_joint4", "loss", 5.0, 8.0, 0.4),
        FaultSpec("", "payload", 6.0),
    )


def test_a_fault_that_had_not_begun_when_it_was_cleared_is_none(make: Maker) -> None:
    later = LossFault(joint="panda_joint4", effectiveness=0.6, start_s=9.0)
    over = msgspec.structs.replace(later, end_s=4.0)
    run = replace(make(), events=(event(3.0, "applied", later), event(4.0, "cleared", over)))
    assert all_faults(run, {}) == ()


def test_an_event_that_holds_no_fault_is_one_line(make: Maker) -> None:
    run = replace(make(), events=(Event(3.0, 2, "rig", "fault applied: {"),))
    with pytest.raises(LogError, match="/events: 'fault applied' at 3"):
        all_faults(run, {})
