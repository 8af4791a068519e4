"""``dftc fault``: break something on a rig that runs, and mend it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import msgspec
from cyclopts import App

from dftc_rt.bus.directory import check_directory, resolve_directory
from dftc_rt.config import toml
from dftc_rt.errors import InputError
from dftc_rt.fault_socket import Answer, Apply, Clear, Request, ask


def fault() -> App:
    """Return the group of commands."""
    group = App(
        name="fault",
        help=(
            "Break something on a rig that runs, and mend it.\n\n"
            "Example::\n\n    dftc fault clear --bus-dir /tmp/dftc-llpy4twz"
        ),
    )
    group.command(apply)
    group.command(clear)
    return group


def apply(fault: str, *, bus_dir: str | Path | None = None, json: bool = False) -> int:
    """Have a fault begin now, on the rig of ``dftc hil`` or ``dftc rig``.

    It takes the place of one of the same kind on the same joint that was applied before.

    Example::

        dftc fault apply '{joint="panda_joint2", kind="loss", effectiveness=0.6}'

    Args:
        fault: As a scenario has it, a TOML table; start_s and end_s count from now.
        bus_dir: Directory that the rig printed; default: as of ``dftc rig``.
        json: Print one JSON object on stdout.

    Returns:
        Exit code 0.

    Raises:
        InputError: It is no fault, no rig is there, or the rig refuses it.
    """
    raw = toml.parse_value(fault)
    if not isinstance(raw, dict):
        raise InputError(
            "fault", repr(fault), 'a table: {joint="…", kind="loss", effectiveness=0.6}'
        )
    request: dict[str, Any] = {"do": "apply", "fault": raw}
    return _send(toml.convert(request, Apply, "fault"), bus_dir, json)


def clear(
    *,
    joint: str | None = None,
    kind: str | None = None,
    bus_dir: str | Path | None = None,
    json: bool = False,
) -> int:
    """End the faults that are active, those of the scenario too; not those of buses.

    Example::

        dftc fault clear --joint panda_joint2

    Args:
        joint: Those of this joint only.
        kind: Those of this kind only.
        bus_dir: Directory that the rig printed; default: as of ``dftc rig``.
        json: Print one JSON object on stdout.

    Returns:
        Exit code 0.

    Raises:
        InputError: No rig is there, or nothing is active.
    """
    return _send(Clear(joint=joint, kind=kind), bus_dir, json)


def _send(request: Request, bus_dir: str | Path | None, json: bool) -> int:
    directory = resolve_directory(bus_dir)
    check_directory(directory)
    answer: Answer = ask(directory, request)
    if json:
        sys.stdout.write(msgspec.json.encode({"t": answer.t, "text": answer.text}).decode() + "\n")
    else:
        sys.stdout.write(f"t {answer.t:.3f} s: {answer.text}\n")
    return 0
