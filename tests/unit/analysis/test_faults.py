"""Faults out of the attached scenario."""

from __future__ import annotations

import pytest

from dftc_rt.analysis.faults import FaultSpec, faults_of, scenario_of
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


def test_no_scenario_no_faults(make: Maker) -> None:
    assert faults_of(scenario_of(make())) == ()


def test_a_damaged_scenario_is_one_line(make: Maker) -> None:
    with pytest.raises(LogError, match=r"scenario\.toml"):
        scenario_of(make("= 1"))
    with pytest.raises(LogError, match=r"fault\[0\]"):
        faults_of(scenario_of(make('[[fault]]\njoint = "a"\n')))
