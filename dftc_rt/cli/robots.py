"""``dftc robots``: the robots that can be given by name."""

from __future__ import annotations

import sys
from typing import Any

import msgspec
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from dftc_rt.config.robot import robot_names
from dftc_rt.dynamics.robot import Robot, load_robot


def robots(*, json: bool = False) -> int:
    """List the robots of ``robots/``: joints, torque limits, buses.

    Example::

        dftc robots --json

    Args:
        json: Print one JSON object on stdout.

    Returns:
        Exit code 0.

    Raises:
        InputError: A ``robot.toml`` or its URDF is wrong.
    """
    found = [load_robot(name) for name in robot_names()]
    if json:
        text = msgspec.json.encode({"robots": [_described(robot) for robot in found]})
        sys.stdout.write(text.decode() + "\n")
        return 0
    # Names are what a scenario needs, so they stay whole; descriptions wrap, on 80 columns too.
    table = Table("robot", Column("joint", no_wrap=True), "limit / Nm", "bus", "node")
    for robot in found:
        drives = robot.joint_config
        table.add_row(
            f"[bold]{escape(robot.name)}[/bold]\n{escape(robot.description)}",
            "\n".join(drive.name for drive in drives),
            "\n".join(f"{drive.torque_limit_nm:g}" for drive in drives),
            "\n".join(drive.bus for drive in drives),
            "\n".join(str(drive.node_id) for drive in drives),
            end_section=True,
        )
    Console(file=sys.stdout).print(table)
    return 0


def _described(robot: Robot) -> dict[str, Any]:
    return {
        "name": robot.name,
        "description": robot.description,
        "dof": robot.n,
        "joints": [
            {
                "name": drive.name,
                "torque_limit_nm": drive.torque_limit_nm,
                "bus": drive.bus,
                "node_id": drive.node_id,
            }
            for drive in robot.joint_config
        ],
        "locked": list(robot.locked),
        "profile": robot.profile,
        "urdf": str(robot.urdf_path),
        "plant": None if robot.closed_form is None else robot.closed_form.name,
    }
