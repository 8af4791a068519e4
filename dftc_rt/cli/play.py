"""``dftc play``: the drives of a recording, for a controller that is to do the same again."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from dftc_rt.bus.directory import resolve_directory
from dftc_rt.bus.frame_record import Records
from dftc_rt.bus.select import choose_bus
from dftc_rt.cli.frames import logged_frames, spelled
from dftc_rt.cli.interruption import stop_requests
from dftc_rt.cli.processes.buses import RigBuses
from dftc_rt.config.load import from_raw
from dftc_rt.config.scenario import Scenario
from dftc_rt.errors import InputError, LogError
from dftc_rt.log.process import dropped_records
from dftc_rt.log.reader import read
from dftc_rt.log.run import CanFrames, Run
from dftc_rt.rt.process import name_process
from hil.playback import Difference, Player, run_playback


def play(
    log: str | Path,
    *,
    bus: str | None = None,
    bus_dir: str | Path | None = None,
    json: bool = False,
) -> int:
    """Play the drives' frames of a log back, and compare what the controller sends with it.

    Stands in for ``dftc rig``: the buses are made in the same way, and the controller sets the
    pace. One that does what it did in the recording sends the same frames, bit for bit; if not,
    the first that differs is named. The log must have been recorded with ``--frames``.

    Example::

        dftc hil panda_shoulder_loss --lockstep --frames --log run.mcap
        dftc play run.mcap --bus unix
        dftc control panda_shoulder_loss --bus unix --lockstep    # in another terminal

    Args:
        log: The log.
        bus: auto, vcan or unix; default: as in the log's scenario.
        bus_dir: Directory of the user-space buses; default as for ``dftc rig``.
        json: Print one JSON object on stdout at the end.

    Returns:
        Exit code: 0 when every frame was equal, 1 when not, 130 when it was ended before.

    Raises:
        LogError: The log cannot be read, or has no frames.
        InputError: The bus or the directory is wrong.
        EnvironmentLacksError: The machine lacks what was asked for.
    """
    run = read(log, frames=True)
    can = logged_frames(run, str(log))
    if lost := dropped_records(run.events, "can"):
        raise LogError(str(log), f"lacks {lost} frames that were dropped", "a whole recording")
    scenario = _scenario(run, str(log))
    choice = choose_bus(scenario.bus.interface if bus is None else bus, can.buses)
    if choice.kind == "inprocess":
        raise InputError("--bus", "'inprocess'", "vcan or unix: the controller is another process")
    # Arbitration is over: the frames come in the order that it gave them.
    table = msgspec.structs.replace(scenario.bus, timing="off", interface=choice.kind)
    buses = RigBuses(can.buses, table, choice)
    directory = resolve_directory(bus_dir)
    name_process("dftc-play")
    ended: list[bool] = []
    with stop_requests(lambda: ended.append(True)):
        buses.open(directory)
        try:
            ports = buses.ports()
            player = Player(ports, can.records)
            where = f" (sockets in {directory})" if choice.kind == "unix" else ""
            print(
                f"{log}: {player.expected} frames of the controller on {', '.join(can.buses)}; "
                f"{choice.reason}{where}; Ctrl-C ends",
                file=sys.stderr,
                flush=True,
            )
            run_playback(player, ports, lambda: bool(ended))
            for port in ports:
                port.close()
        finally:
            buses.release()
    return _report(player, run, can, json, interrupted=bool(ended))


def _scenario(run: Run, where: str) -> Scenario:
    """Return the scenario that the log carries."""
    if not run.scenario:
        raise LogError(where, "no scenario.toml in it", "a log as dftc wrote it")
    return from_raw(tomllib.loads(run.scenario), f"{where} scenario.toml").scenario


def _report(player: Player, run: Run, can: CanFrames, json: bool, *, interrupted: bool) -> int:
    """Print what was found; return the exit code."""
    missing = player.missing()
    first = player.first or missing
    equal = first is None
    if json:
        found: dict[str, Any] = {
            "equal": equal,
            "frames": player.expected,
            "compared": player.compared,
            "differing": player.differing,
            "first_difference": None if first is None else _facts(first, run, can),
        }
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    elif first is None:
        print(f"{player.compared} frames equal on {', '.join(can.buses)}")
    else:
        print(_line(first, run, can))
        print(
            f"{player.compared} of {player.expected} frames compared, {player.differing} of them "
            f"differ" + ("; ended there" if player.derailed else "")
        )
    if equal:
        return 0
    return 130 if interrupted and player.first is None else 1


def _facts(difference: Difference, run: Run, can: CanFrames) -> dict[str, Any]:
    """Return where a difference is and what it is, for JSON."""
    cycle, t = _cycle(difference, run)
    return {
        "cycle": cycle,
        "t": t,
        "bus": can.buses[difference.bus],
        "expected": _frame(difference.expected),
        "found": _frame(difference.found),
    }


def _line(difference: Difference, run: Run, can: CanFrames) -> str:
    """Return a difference in one line."""
    cycle, t = _cycle(difference, run)
    when = "set-up" if cycle is None else f"cycle {cycle} (t = {t:.3f} s)"
    if difference.expected is None:
        when = "behind the recording's end"
    expected, found = _frame(difference.expected), _frame(difference.found)
    bus = can.buses[difference.bus]
    if difference.data_only:
        number, _, was = str(expected).partition(" ")
        now = str(found).partition(" ")[2]
        return f"first difference: {when}, {bus}, {number}: expected {was}, found {now}"
    return (
        f"first difference: {when}, {bus}: expected {expected or 'none'}, found {found or 'none'}"
    )


def _cycle(difference: Difference, run: Run) -> tuple[int | None, float | None]:
    """Return the cycle in which the expected frame was sent, None in set-up; and its time, s."""
    if difference.expected is None:
        return None, None
    t = float(difference.expected["t"][0])
    cycle = int(np.searchsorted(run.cycle["t"], t, side="right")) - 1
    return (None if cycle < 0 else cycle), t


def _frame(record: Records | None) -> str | None:
    return None if record is None else spelled(record[0])
