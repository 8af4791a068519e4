"""A scenario and its robot for commands that look at the buses only."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dftc_rt.config.load import load_scenario
from dftc_rt.config.scenario import Scenario
from dftc_rt.dynamics.robot import Robot, load_robot
from hil import SCENARIOS


def scenario_and_robot(
    scenario: str | Path, settings: Sequence[str] = ()
) -> tuple[Scenario, Robot]:
    """Load a scenario and its robot, however its buses are loaded.

    Raises:
        InputError: Something in the scenario or the robot is wrong.
    """
    loaded = load_scenario(scenario, settings, SCENARIOS).scenario
    table = loaded.robot
    robot = load_robot(
        name=table.name,
        urdf=table.urdf,
        plant=table.plant,
        lock=table.lock,
        home_rad=table.home_rad,
        joints_per_bus=table.joints_per_bus,
    )
    return loaded, robot
