"""``dftc rig``: the emulated robot alone, for somebody else's controller."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from dftc_rt.bus.directory import resolve_directory
from dftc_rt.bus.select import BusChoice
from dftc_rt.cli import session
from dftc_rt.cli.interruption import stop_requests
from dftc_rt.cli.processes.buses import RigBuses, choose, make_rig
from dftc_rt.cli.processes.roles import RIG_PRIORITY, rig_core, take_faults
from dftc_rt.cli.session import Session
from dftc_rt.cli.simulate import warm_up
from dftc_rt.drives.wiring import bus_names
from dftc_rt.errors import InputError
from dftc_rt.ring import EventRing, Ring
from dftc_rt.rt.process import RealTime, name_process, report_refused
from hil.bus.statistics import BusStatistics
from hil.fault_desk import FaultDesk
from hil.loop import run_lockstep, run_wall
from hil.rig import Rig


def rig(
    scenario: str | Path,
    *,
    bus: str | None = None,
    bus_dir: str | Path | None = None,
    lockstep: bool = False,
    set_: Sequence[str] = (),
    json: bool = False,
) -> int:
    """Serve the emulated robot until SIGINT or SIGTERM.

    The user-space buses are sockets in one directory: ``--bus-dir``, else $DFTC_BUS_DIR,
    else $XDG_RUNTIME_DIR/dftc or /tmp/dftc-UID.

    Example::

        dftc rig panda_shoulder_loss --bus unix

    Args:
        scenario: Scenario file, or the name of a shipped one.
        bus: auto, vcan or unix; default: as in the scenario.
        bus_dir: Directory of the user-space buses.
        lockstep: Rig time moves by the controller's barriers only.
        set_: Override a key, ``a.b=value``; may be repeated.
        json: Print one JSON object on stdout at the end.

    Returns:
        Exit code 0.

    Raises:
        InputError: The scenario or the directory is wrong.
        EnvironmentLacksError: The machine lacks what was asked for.
    """
    opened = session.open_session(scenario, set_)
    names = bus_names(opened.robot.joint_config)
    choice = choose(opened, bus, lockstep=lockstep)
    if choice.kind == "inprocess":
        raise InputError("--bus", "'inprocess'", "vcan or unix: a rig alone is another process")
    warm_up(opened)
    buses = RigBuses(names, opened.scenario.bus, choice)
    directory = resolve_directory(bus_dir)
    name_process("dftc-rig")
    ended: list[bool] = []
    with stop_requests(lambda: ended.append(True)):
        buses.open(directory)
        try:
            made, statistics = _serve(
                opened, choice, buses, directory, lambda: bool(ended), lockstep=lockstep
            )
        finally:
            buses.release()
    if json:
        found = {
            "rig_time_s": made.t,
            "steps": made.steps,
            "stalls": made.stalls,
            "joints": {
                name: {"q_rad": q, "v_rad_s": v}
                for name, q, v in zip(
                    opened.robot.joints, made.plant.q.tolist(), made.plant.v.tolist(), strict=True
                )
            },
            "buses": {name: msgspec.to_builtins(each) for name, each in statistics.items()},
        }
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        print(f"served {made.steps} cycles in {made.t:.3f} s of rig time")
        for name, each in statistics.items():
            print(traffic(name, each, made.t))
    return 0


def _serve(
    opened: Session,
    choice: BusChoice,
    buses: RigBuses,
    directory: Path,
    ended: Callable[[], bool],
    *,
    lockstep: bool,
) -> tuple[Rig, dict[str, BusStatistics]]:
    """Serve until ``ended``; return the rig and what went over each bus."""
    truth = Ring.create("dftc-rig", 4096, opened.rig.size)
    events = EventRing.create("dftc-events-rig")
    real_time: RealTime | None = None
    desk: FaultDesk | None = None
    try:
        ports = buses.ports()
        made = make_rig(opened, ports, truth, events.write)
        if buses.directory is not None:
            desk = take_faults(made, opened, directory, _say)
        where = f" (sockets in {directory})" if choice.kind == "unix" else ""
        print(
            f"{opened.robot.name}: {opened.robot.n} drives on {', '.join(buses.names)}; "
            f"{choice.reason}{where}; Ctrl-C ends",
            file=sys.stderr,
            flush=True,
        )
        if lockstep:
            run_lockstep(made, ports, ended)
        else:
            real_time = RealTime(RIG_PRIORITY, rig_core(opened))
            report_refused("rig", real_time.refused)
            run_wall(made, ports, ended)
        statistics = {port.name: port.statistics for port in ports}
        for port in ports:
            port.close()
        return made, statistics
    finally:
        if desk is not None:
            desk.close()
        if real_time is not None:
            real_time.release()


def _say(t: float, severity: int, source: str, text: str) -> None:
    """Tell of a fault that came while the rig runs: nobody logs here."""
    print(f"t {t:.3f} s  {text}", file=sys.stderr, flush=True)


def traffic(name: str, found: BusStatistics, duration_s: float) -> str:
    """One line on what has gone over a bus."""
    line = f"{name}: {found.frames} frames"
    if found.exact_bits and duration_s > 0.0:
        line += f", {found.load(duration_s):.1%} of the time"
    if found.latency_us:
        slowest = max(found.latency_us, key=lambda number: found.latency_us[number])
        line += f", through within {found.latency_us[slowest]:.0f} µs (the slowest: {slowest})"
    for word in ("dropped", "malformed", "lost", "errors", "duplicated", "delayed", "babbled"):
        if count := getattr(found, word):
            line += f", {count} {word}"
    return line
