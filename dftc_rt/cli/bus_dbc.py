"""``dftc bus dbc``: the traffic of a robot's buses as DBC files."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dftc_rt.bus.dbc import dbc_text, require_cantools
from dftc_rt.cli import session
from dftc_rt.cli.bus_database import bus_messages, cycle_ms
from dftc_rt.cli.bus_database_mit import mit_messages
from dftc_rt.cli.bus_database_moteus import moteus_messages
from dftc_rt.cli.output import check_output
from dftc_rt.cli.session import Session
from dftc_rt.drives.mit.scale import scales_of as mit_scales_of
from dftc_rt.drives.moteus.scale import scales_of as moteus_scales_of
from dftc_rt.drives.scale import ScaleTable
from dftc_rt.drives.wiring import bus_members, bus_names, robot_drives
from dftc_rt.errors import InputError


def dbc(
    scenario: str | Path,
    *,
    output: Annotated[str | Path, Parameter(alias="-o")],
    force: bool = False,
    set_: Sequence[str] = (),
) -> int:
    """Write a DBC of the traffic: names, scales and units for cantools, SavvyCAN and the like.

    A DBC describes one bus. A robot with several gets a file for each: of ``-o panda.dbc``,
    panda-can0.dbc, panda-can1.dbc and so on. The scales are those of a run: a calibration's
    torque constants are in them. Needs the extra ``dbc``.

    Example::

        dftc bus dbc panda_shoulder_loss -o panda.dbc

    Args:
        scenario: Scenario file, or the name of a shipped one.
        output: The file to write.
        force: Replace files that are there.
        set_: Override a key, ``a.b=value``; may be repeated.

    Returns:
        Exit code 0.

    Raises:
        InputError: The scenario is wrong, or a file is there or cannot be written.
        EnvironmentLacksError: cantools is not installed.
    """
    require_cantools()
    opened = session.open_session(scenario, set_)
    names = bus_names(opened.robot.joint_config)
    paths = {name: _path(Path(output), name, len(names)) for name in names}
    for path in paths.values():
        if not force and os.path.lexists(path):
            raise InputError(str(path), "is there already", "a new file, or --force")
        check_output(path)
    for name, path in paths.items():
        path.write_bytes(_text(opened, name).encode("cp1252", "replace"))  # the format's own
        sys.stdout.write(f"{path}\n")
    return 0


def _path(output: Path, bus: str, buses: int) -> Path:
    """Return the file of one bus."""
    if buses == 1:
        return output
    return output.with_name(f"{output.stem}-{bus}{output.suffix}")


def _text(opened: Session, bus: str) -> str:
    """Return the DBC of one bus."""
    robot = opened.parts.robot
    members = bus_members(robot.joint_config, bus)
    joints = [robot.joint_config[i] for i in members]
    prismatic = robot.prismatic[members].tolist()
    drives = robot_drives(robot, opened.scenario.bus)
    there = [drives[i] for i in members]
    rate_hz = opened.scenario.executor.rate_hz
    match opened.scenario.bus.profile:
        case "mit":
            messages = mit_messages(joints, prismatic, mit_scales_of(there), cycle_ms(rate_hz))
        case "moteus":
            scales = moteus_scales_of(there)
            messages = moteus_messages(joints, prismatic, scales, cycle_ms(rate_hz))
        case "cia402":
            table = ScaleTable(opened.parts.scales.values[:, members])
            messages = bus_messages(joints, prismatic, table, rate_hz)
    return dbc_text(messages, f"{opened.scenario.name} {bus}")
