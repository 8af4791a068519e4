"""``dftc control --set-up-only``: everything that a run does before it gives torque."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import msgspec
from rich.console import Console
from rich.table import Table

from dftc_rt.bus.interface import FrameSocket
from dftc_rt.cli.session import Session
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import profile
from dftc_rt.drives.wiring import robot_drives


def set_up_only(opened: Session, sockets: Sequence[FrameSocket], *, json: bool) -> int:
    """Set every drive up, say where it is, and take its power off again.

    Args:
        opened: The session.
        sockets: One a bus, in the order of ``bus_names``.
        json: Print one JSON object on stdout.

    Returns:
        0, or 1 when a drive did not confirm that it is off.

    Raises:
        DriveError: A drive is missing, or is not what the robot file says.
        BusError: A bus has gone away.
    """
    rate_hz = opened.scenario.executor.rate_hz
    drives = robot_drives(opened.robot, opened.scenario.bus)
    chosen = profile(opened.scenario.bus.profile)
    setup = chosen.setup(sockets, drives, rate_hz)
    try:
        found = setup.configure()
    finally:
        silent = setup.shutdown()
    cycle = chosen.cycle(drives, len(sockets), rate_hz)
    cycle.start(found)
    rows = [
        {
            "joint": drive.scale.joint,
            "node": drive.node_id,
            "bus": sockets[drive.bus].name,
            "state": states.STATE_NAMES[states.state_of(int(found.statusword[k]))],
            "position": float(cycle.q[k]),
            "off_again": drive.scale.joint not in silent,
        }
        for k, drive in enumerate(drives)
    ]
    if json:
        out = {"ok": not silent, "drives": rows}
        sys.stdout.write(msgspec.json.encode(out).decode() + "\n")
    else:
        _show(rows)
    return int(bool(silent))


def _show(rows: Sequence[dict[str, Any]]) -> None:
    table = Table(show_edge=False, pad_edge=False)
    for name in ("joint", "node", "bus", "was set up, and is"):
        table.add_column(name)
    table.add_column("at / rad", justify="right")
    table.add_column("off again")
    for row in rows:
        table.add_row(
            row["joint"], str(row["node"]), row["bus"], row["state"], f"{row['position']:.4f}",
            "yes" if row["off_again"] else "not confirmed",
        )  # fmt: skip
    Console(file=sys.stdout).print(table)
