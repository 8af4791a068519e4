"""A scenario's robot, its drives wired to buses as the scenario's profile and rate allow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dftc_rt.bus.budget import joints_per_bus
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
    return loaded, scenario_robot(loaded)


def scenario_robot(scenario: Scenario) -> Robot:
    """Load a scenario's robot, however its buses are loaded.

    A bare URDF does not say how its drives are wired: they get as few buses as will do.

    Raises:
        InputError: Something in the scenario or the robot is wrong.
    """
    table, bus = scenario.robot, scenario.bus
    most = joints_per_bus(
        rate_hz=scenario.executor.rate_hz,
        bitrate=bus.bitrate,
        data_bitrate=bus.data_bitrate,
        profile=bus.profile,
    )
    return load_robot(
        name=table.name,
        urdf=table.urdf,
        plant=table.plant,
        lock=table.lock,
        home_rad=table.home_rad,
        joints_per_bus=table.joints_per_bus,
        unstated_joints_per_bus=max(most, 1),  # a bus that is overloaded is told of later
    )
