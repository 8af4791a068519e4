"""Which drives the rig emulates: those of the scenario's profile."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Final

from dftc_rt.config.scenario import Scenario
from dftc_rt.drives.scale import ScaleTable
from dftc_rt.drives.wiring import bus_names, robot_drives
from dftc_rt.dynamics.model import Robot
from hil.drive.interface import EmulatedDrives
from hil.drive.mit import MitDrives
from hil.drive.moteus import MoteusDrives
from hil.drive.node402 import Cia402Drives
from hil.drive.spec import DriveSpec

_KINDS: Final[dict[str, Callable[[Sequence[DriveSpec], int], EmulatedDrives]]] = {
    "cia402": Cia402Drives,
    "mit": MitDrives,
    "moteus": MoteusDrives,
}


def emulated_drives(scenario: Scenario, robot: Robot) -> tuple[EmulatedDrives, ScaleTable]:
    """Return a robot's drives, powered on, and what their counts are worth at the joints.

    Their torque constants are nominal: what is true of them is the plant's.

    Args:
        scenario: The resolved scenario.
        robot: The robot.

    Raises:
        InputError: A value is out of what a drive can express.
    """
    nominal = dataclasses.replace(robot, torque_constant=None)
    specs = [
        DriveSpec(drive.node_id, drive.bus, drive.scale, scenario.rig.drive.watchdog_s)
        for drive in robot_drives(nominal, scenario.bus)
    ]
    drives = _KINDS[scenario.bus.profile](specs, len(bus_names(robot.joint_config)))
    return drives, ScaleTable.of([spec.scale for spec in specs])
