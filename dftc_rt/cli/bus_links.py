"""``dftc bus up`` and ``dftc bus down``: the kernel's virtual buses."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from dftc_rt.bus.select import vcan_name
from dftc_rt.bus.vcan_links import bring_up, take_down
from dftc_rt.cli.bus_robot import scenario_and_robot
from dftc_rt.drives.wiring import bus_names

_BUSES = re.compile(r"v?can[0-9]+(,v?can[0-9]+)*")


def up(buses: str | Path) -> int:
    """Make the vcan links that stand in for a robot's buses: vcan0 for can0, and so on.

    What is there already stays; a link of another kind is never touched. Needs root, and
    a kernel with SocketCAN and vcan; without them the rig has its user-space bus.

    Example::

        dftc bus up panda_shoulder_loss

    Args:
        buses: Scenario file, the name of a shipped scenario, or buses: can0,can1.

    Returns:
        Exit code 0.

    Raises:
        InputError: The scenario is wrong, or a link of that name is no vcan.
        EnvironmentLacksError: The kernel has no vcan, or permits it not.
    """
    return _say(bring_up(_links(buses)))


def down(buses: str | Path) -> int:
    """Remove the vcan links that stand in for a robot's buses.

    What is not there needs no removing; a link of another kind is never touched.

    Example::

        dftc bus down can0,can1,can2

    Args:
        buses: Scenario file, the name of a shipped scenario, or buses: can0,can1.

    Returns:
        Exit code 0.

    Raises:
        InputError: The scenario is wrong, or a link of that name is no vcan.
        EnvironmentLacksError: The kernel permits it not.
    """
    return _say(take_down(_links(buses)))


def _links(buses: str | Path) -> list[str]:
    """Return the links of a scenario's buses, or of those that are listed.

    Raises:
        InputError: The scenario is wrong.
    """
    text = str(buses)
    if _BUSES.fullmatch(text) and not Path(text).exists():
        names = [bus.removeprefix("v") for bus in text.split(",")]
    else:
        _, robot = scenario_and_robot(buses)
        names = bus_names(robot.joint_config)
    return [vcan_name(name) for name in dict.fromkeys(names)]


def _say(done: dict[str, str]) -> int:
    for name, what in done.items():
        sys.stdout.write(f"{name}: {what}\n")
    return 0
