"""``dftc bus up`` and ``dftc bus down``: the kernel's virtual buses."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from dftc_rt.bus.select import vcan_name
from dftc_rt.bus.vcan_links import bring_up, take_down
from dftc_rt.cli.bus_robot import scenario_and_robot
from dftc_rt.drives.wiring import bus_names, fd_bitrate
from dftc_rt.errors import InputError

_BUSES = re.compile(r"v?can[0-9]+(,v?can[0-9]+)*")


def up(buses: str | Path, *, set_: Sequence[str] = ()) -> int:
    """Make the vcan links that stand in for a robot's buses: vcan0 for can0, and so on.

    What is there already stays; a link of another kind is never touched. Links of a scenario
    whose profile is CAN FD are set to carry it. Needs root, and a kernel with SocketCAN and
    vcan; without them the rig has its user-space bus.

    Example::

        dftc bus up panda_shoulder_loss

    Args:
        buses: Scenario file, the name of a shipped scenario, or buses: can0,can1.
        set_: Override a key of the scenario, ``a.b=value``; may be repeated.

    Returns:
        Exit code 0.

    Raises:
        InputError: The scenario is wrong, or a link of that name is no vcan.
        EnvironmentLacksError: The kernel has no vcan, or permits it not.
    """
    names, fd = _links(buses, set_)
    return _say(bring_up(names, fd=fd))


def down(buses: str | Path, *, set_: Sequence[str] = ()) -> int:
    """Remove the vcan links that stand in for a robot's buses.

    What is not there needs no removing; a link of another kind is never touched.

    Example::

        dftc bus down can0,can1,can2

    Args:
        buses: Scenario file, the name of a shipped scenario, or buses: can0,can1.
        set_: Override a key of the scenario, ``a.b=value``; may be repeated.

    Returns:
        Exit code 0.

    Raises:
        InputError: The scenario is wrong, or a link of that name is no vcan.
        EnvironmentLacksError: The kernel permits it not.
    """
    names, _ = _links(buses, set_)
    return _say(take_down(names))


def _links(buses: str | Path, settings: Sequence[str]) -> tuple[list[str], bool]:
    """Return the links of a scenario's buses, or of those listed; whether they carry CAN FD.

    Raises:
        InputError: The scenario is wrong.
    """
    text = str(buses)
    if _BUSES.fullmatch(text) and not Path(text).exists():
        if settings:
            raise InputError("--set", repr(settings[0]), "a scenario to override a key of")
        names, fd = [bus.removeprefix("v") for bus in text.split(",")], False
    else:
        scenario, robot = scenario_and_robot(buses, settings)
        names, fd = bus_names(robot.joint_config), fd_bitrate(scenario.bus) is not None
    return [vcan_name(name) for name in dict.fromkeys(names)], fd


def _say(done: dict[str, str]) -> int:
    for name, what in done.items():
        sys.stdout.write(f"{name}: {what}\n")
    return 0
