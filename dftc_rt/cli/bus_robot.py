"""A scenario's robot, its drives wired to buses as the scenario's profile and rate allow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dftc_rt.config.load import load_scenario
from dftc_rt.config.scenario import Scenario
from dftc_rt.controller import scenario_robot
from dftc_rt.dynamics.model import Robot
from hil import SCENARIOS


def scenario_and_robot(
    scenario: str | Path, settings: Sequence[str] = ()
) -> tuple[Scenario, Robot]:
    """Load a scenario and its robot, however its buses are loaded.

    Raises:
        InputError: Something in the scenario or the robot is wrong.
    """
    loaded = load_scenario(scenario, settings, SCENARIOS).scenario
    return loaded, scenario_robot(loaded)
