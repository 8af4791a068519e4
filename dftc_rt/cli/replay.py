"""``dftc replay``: the controller again over a log, as it was or with other settings."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from cyclopts import Parameter
from rich import box
from rich.console import Console
from rich.table import Table

from dftc_rt.cli import session
from dftc_rt.cli.output import check_output
from dftc_rt.cli.session import Session
from dftc_rt.control.signals import NAMES, VERDICTS
from dftc_rt.drives.scale import TORQUE_PER_COUNT
from dftc_rt.errors import LogError
from dftc_rt.log.ending import SOURCE, ending_of, ending_text
from dftc_rt.log.pieces import read_pieces
from dftc_rt.log.reader import read
from dftc_rt.log.run import Run
from dftc_rt.log.schema import Layout, cycle_layout, rig_layout
from dftc_rt.replay import stored, verdicts
from dftc_rt.replay.compare import Comparison, Difference, compare
from dftc_rt.replay.loop import Replayed
from dftc_rt.replay.loop import replay as run_again
from dftc_rt.replay.stored import Stored
from dftc_rt.replay.verdicts import Told
from dftc_rt.ring import Event
from dftc_rt.rt.executor import INFO

_AT_ONCE_S = 0.01
NOTE = "replay"
"""Metadata of a log that a replay has written."""


def replay(
    *logs: Path,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    set_: Sequence[str] = (),
    json: bool = False,
) -> int:
    """Run the control code again over the feedback of a log.

    As it was: every command, estimate and verdict must come out equal to the last bit, or the
    first difference is told. With --set: what the estimators and the decision would have made
    of this very feedback. It is that of the commands in the log, and does not answer to those
    of the replay.

    Example::

        dftc replay run.mcap
        dftc replay run.mcap --set control.gains.threshold_loss=25 -o other.mcap

    Args:
        logs: The log; of a run whose recorder had to be started again, all its files in order.
        output: Write the replay to this MCAP file, for ``dftc analyze`` and ``dftc report``.
        set_: Override a key of control or supervisor, ``a.b=value``; may be repeated.
        json: Print one JSON object on stdout.

    Returns:
        Exit code: 1 when a replay without --set differs.

    Raises:
        LogError: A log cannot be read, or does not hold what a replay needs.
        InputError: A setting cannot be asked of a log, or the output not be written.
    """
    if not logs:
        raise LogError("dftc replay", "no log", "the log of a run")
    where = " ".join(str(log) for log in logs)
    if output is not None:
        for log in logs:
            if os.path.exists(log) and os.path.exists(output) and os.path.samefile(log, output):
                raise LogError(str(output), "the log itself", "another file to write to")
        check_output(output)
    run = read(logs[0]) if len(logs) == 1 else _joined(logs)
    if "settings" in run.metadata.get(NOTE, {}):
        source = run.metadata[NOTE].get("source", "its source")
        raise LogError(where, "was written by dftc replay --set", f"what it replays, {source}")
    again = stored.controller_of(run, set_, where)
    replayed = run_again(again, run, where)
    found: dict[str, Any] = {"log": where, "settings": list(set_)}
    if output is not None:
        _write(output, run, again, replayed, {"source": where} | _settings(set_))
        found["output"] = str(output)
    if set_:
        return _tell_what_if(run, again, replayed, found, json)
    return _tell_difference(run, replayed, found, json)


def _joined(logs: Sequence[Path]) -> Run:
    """The run that is in several files, once they are known to be of one."""
    first, *others = [(log, read(log, torn=True)) for log in logs]
    for log, other in others:
        same = (other.scenario, other.joints) == (first[1].scenario, first[1].joints)
        if not (same and other.metadata.get("dftc_rt") == first[1].metadata.get("dftc_rt")):
            raise LogError(str(log), "is of another run", f"a later file of {first[0]}'s")
    return read_pieces(logs)[0]


def _settings(given: Sequence[str]) -> dict[str, str]:
    return {"settings": "\n".join(given)} if given else {}


# -- as it was ----------------------------------------------------------------------------


def _tell_difference(run: Run, replayed: Replayed, found: dict[str, Any], json: bool) -> int:
    result = compare(run, replayed)
    if json:
        found |= {"equal": result.first is None, **result.builtins()}
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        console = Console(file=sys.stdout, soft_wrap=True, highlight=False)
        console.print(_sentence(run, replayed, result), markup=False)
        if result.spreads:
            console.print(_spreads(result))
        for line in _other_versions(run) if result.first else ():
            console.print(line, markup=False)
        if "output" in found:
            console.print(f"wrote {found['output']}", markup=False)
    return 0 if result.first is None else 1


def _sentence(run: Run, replayed: Replayed, result: Comparison) -> str:
    if result.first is not None:
        return f"The replay differs. First difference: {_told(result.first)}."
    t = replayed.cycle["t"]
    what = f"{result.cycles} cycles of {len(run.joints)} joints are equal to the last bit"
    if replayed.ended:
        state, reason = replayed.outcome.end_state, replayed.outcome.reason
        return f"{what}; the end too: {state}{f' ({reason})' if reason else ''}."
    if result.cycles < result.logged:
        return (
            f"{what}. After {t[-1]:.3f} s cycles are missing in the log: the "
            f"{result.logged - result.cycles} behind cannot be replayed."
        )
    return f"{what}. The log ends at {t[-1]:.3f} s, before its run did."


def _told(first: Difference) -> str:
    of = f" of {first.joint}" if first.joint else ""
    what = "the end" if first.signal == "end" else first.signal
    return (
        f"cycle {first.cycle} ({first.t:.4f} s), {what}{of}: "
        f"logged {first.logged}, replayed {first.replayed}"
    )


def _spreads(result: Comparison) -> Table:
    table = _table("signal", "cycles", "largest", "of", "at\ns")
    for each in result.spreads:
        largest = f"{each.largest:.3g}" if np.isfinite(each.largest) else "no number"
        table.add_row(each.signal, str(each.cycles), largest, each.joint or "–", f"{each.t:.3f}")
    return table


def _other_versions(run: Run) -> list[str]:
    """What is not as it was when the log was written."""
    return [
        f"{name}: {was} when it was logged, {now} here"
        for name, now in session.versions().items()
        if name != "kernel" and (was := run.metadata.get("versions", {}).get(name, now)) != now
    ]


# -- with other settings ------------------------------------------------------------------


def _tell_what_if(
    run: Run, again: Stored, replayed: Replayed, found: dict[str, Any], json: bool
) -> int:
    count = len(replayed.cycle["t"]) - int(replayed.parted)  # cycles of the same state
    period = 1.0 / again.scenario.executor.rate_hz
    before, after = (
        verdicts.told(run, {name: rows[:count] for name, rows in cycle.items()}, period)
        for cycle in (run.cycle, replayed.cycle)
    )
    step = np.abs(again.parts.scales.values[TORQUE_PER_COUNT])
    stops = count - int(replayed.outcome.end_state != "done")  # its last command is the stop
    moved = {name: rows[:stops] for name, rows in replayed.cycle.items()}
    other = verdicts.same_commands_until(run, moved, again.units, step)
    stop = _stop(run, replayed)
    if json:
        found |= {
            "cycles": count,
            "cycles_logged": len(run.cycle["t"]),
            "stop": stop or None,
            "other_command_s": None if other is None else other[0],
            "other_command_joint": None if other is None else other[1],
            "joints": {
                joint: {"logged": asdict(before[joint]), "replayed": asdict(after[joint])}
                for joint in run.joints
            },
        }
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
        return 0
    console = Console(file=sys.stdout, soft_wrap=True, highlight=False)
    console.print(_joints(before, after))
    for line in (_commands(other), stop):
        if line:
            console.print(line, markup=False)
    if "output" in found:
        console.print(f"wrote {found['output']}", markup=False)
    return 0


def _joints(before: Mapping[str, Told], after: Mapping[str, Told]) -> Table:
    """A row a joint as it was logged, and one below it where the replay says something else."""
    known = any(each.alarms_s is not None for each in before.values())
    names = ["joint", "", "anomaly\ns", "verdict", "\ns", "ρ̂ at the end"]
    table = _table(*names, *(["false\ns"] if known else []))
    for joint, was in before.items():
        one, other = (_cells(told, known) for told in (was, after[joint]))
        table.add_row(joint, "logged" if one != other else "both", *one)
        if one != other:
            table.add_row("", "replayed", *other, style="bold")
    return table


def _cells(told: Told, known: bool) -> list[str]:
    verdict = "–" if told.verdict is None else VERDICTS[told.verdict]
    cells = [_time(told.anomaly_s), verdict, _time(told.attributed_s), _rho(told)]
    return [*cells, _time(told.alarms_s or None)] if known else cells


def _time(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _rho(told: Told) -> str:
    if told.rho is None:
        return "–"
    return f"{told.rho:.3f}" + ("" if told.rho_std is None else f" ± {told.rho_std:.3f}")


def _commands(other: tuple[float, str] | None) -> str:
    """How far the answer is one about what would have happened."""
    if other is None:
        return "Every command is as logged: this is what would have happened."
    t, joint = other
    rest = "what these settings make of the motion in the log, which answers to the commands there"
    if t < _AT_ONCE_S:
        return f"{joint} is told something else from {t:.3f} s on: this is {rest}."
    return (
        f"Up to {t:.3f} s every command is as logged: that much would have happened. There {joint} "
        f"is first told something else; from then on this is {rest}."
    )


def _stop(run: Run, replayed: Replayed) -> str:
    """Why the replay ends where it does, when that is not the end of the log."""
    t = replayed.cycle["t"]
    if replayed.parted:
        if replayed.outcome.end_state != "done":
            told = f"a {replayed.outcome.end_state}: {replayed.outcome.reason}"
            return f"At {t[-1]:.3f} s the replay ends in {told}; the logged run went on."
        ending = ending_of(run.events)
        told = f"{ending.end_state}: {ending.reason}" if ending else "another state"
        return f"At {t[-1]:.3f} s the logged run came to {told}; with these settings it goes on."
    if len(t) < len(run.cycle["t"]):
        return f"After {t[-1]:.3f} s cycles are missing in the log; the replay ends there."
    return ""


def _table(*names: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for name in names:
        left = name in ("", "joint", "verdict", "signal", "of")
        table.add_column(name, justify="left" if left else "right", overflow="fold")
    return table


# -- the log of a replay ------------------------------------------------------------------


def _write(
    path: Path, run: Run, again: Stored, replayed: Replayed, note: Mapping[str, str]
) -> None:
    """Write what was replayed, with the truth and the other processes' events of the log."""
    layout, rig = cycle_layout(run.joints, NAMES), rig_layout(run.joints)
    opened = Session(again.scenario, again.text, again.robot, again.parts, layout, rig, again.files)
    last = float(replayed.cycle["t"][-1])
    epoch_ns = int(run.metadata.get("dftc_rt", {}).get("epoch_ns", 0))
    truth = None if run.rig is None else {k: v[run.rig["t"] <= last] for k, v in run.rig.items()}
    theirs = [each for each in run.events if each.source != SOURCE and each.t <= last]
    counters = asdict(replayed.outcome.counters)
    end = replayed.outcome.end_state, replayed.outcome.reason
    if not replayed.ended and end[0] == "done":
        end = "cut off", "the log holds no more that can be replayed"
    said = Event(last, INFO, SOURCE, ending_text(*end, counters))
    with opened.recorder(
        path, epoch_ns, with_rig=truth is not None, notes={NOTE: note}
    ) as recorder:
        for event in sorted((*replayed.events, *theirs), key=lambda event: event.t):
            recorder.write_event(*event)
        recorder.write_cycles(_records(layout, replayed.cycle))
        if truth is not None:
            recorder.write_rig(_records(rig, truth))
        recorder.write_event(*said)


def _records(layout: Layout, rows: Mapping[str, Any]) -> Any:
    """Rows by name as records, (K, size)."""
    names = (*layout.header, *layout.rows)
    return np.hstack([rows[name].reshape(len(rows["t"]), -1) for name in names])
