"""``dftc hil``: rig, controller and recorder as processes, over a virtual bus, in real time."""

from __future__ import annotations

import contextlib
import functools
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from dftc_rt.analysis.report import write_report
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.bus.select import BusChoice
from dftc_rt.cli import session
from dftc_rt.cli.output import log_file
from dftc_rt.cli.processes import roles
from dftc_rt.cli.processes.buses import RigBuses, choose, join, make_rig
from dftc_rt.cli.processes.child import Flags
from dftc_rt.cli.processes.launcher import Ended, Launcher
from dftc_rt.cli.processes.roles import Rings
from dftc_rt.cli.session import Session
from dftc_rt.cli.simulate import warm_up
from dftc_rt.cli.status import Status
from dftc_rt.drives.wiring import bus_names, fd_bitrate
from dftc_rt.errors import DftcError
from dftc_rt.log import live
from dftc_rt.log.pieces import read_pieces
from dftc_rt.rt.executor import Counters, Outcome
from dftc_rt.rt.process import report_refused
from dftc_rt.view.server import check_installed
from hil.bus.port import BusPort
from hil.fault_desk import FaultDesk
from hil.rig import Rig
from hil.simulate import in_process_rig

_CRASH_MARGIN_S = 0.1


def hil(
    scenario: str | Path,
    *,
    bus: str | None = None,
    lockstep: bool = False,
    log: str | Path | None = None,
    set_: Sequence[str] = (),
    bus_dir: str | Path | None = None,
    frames: bool = False,
    foxglove: bool = False,
    foxglove_port: int | None = None,
    view: bool = False,
    report: Annotated[bool, Parameter(negative="--no-report")] = True,
    json: bool = False,
) -> int:
    """Run rig, controller and recorder; in real time unless ``lockstep``.

    Ends with a summary, and names the log and the report that it wrote.

    Example::

        dftc hil panda_shoulder_loss --set duration_s=10

    Args:
        scenario: Scenario file, or the name of a shipped one.
        bus: auto, vcan, unix or inprocess; default: as in the scenario.
        lockstep: As fast as it goes, repeatable to the byte.
        log: MCAP file to write; default: logs/SCENARIO-TIME.mcap.
        set_: Override a key, ``a.b=value``; may be repeated.
        bus_dir: Directory of the user-space buses; default: a private one.
        frames: Log every frame that the controller sends and receives, to /can.
        foxglove: Let Foxglove or Lichtblick on this machine watch the run, at ws://127.0.0.1:8765.
        foxglove_port: The same at another port.
        view: Serve a page on 127.0.0.1 with the robot, curves and a panel of faults.
        report: Write an HTML report beside the log.
        json: Print one JSON object on stdout.

    Returns:
        Exit code.

    Raises:
        InputError: The scenario is wrong.
        EnvironmentLacksError: The machine lacks what was asked for.
    """
    if view:
        check_installed()
    opened = session.open_session(scenario, set_)
    choice = choose(opened, bus, lockstep=lockstep)
    live_port = _live_port(foxglove, foxglove_port)
    with log_file(opened, log, report=report) as path:
        warm_up(opened)
        with tempfile.TemporaryDirectory(prefix="dftc-") as private:
            directory = Path(bus_dir) if bus_dir is not None else Path(private)
            ended = _over(
                opened,
                choice,
                directory,
                Path(private),
                path,
                lockstep,
                frames,
                json,
                live_port,
                view,
            )
        return finish(opened, ended, report=report, json=json)


def _live_port(foxglove: bool, port: int | None) -> int | None:
    """Return the port for viewers, checked; None: nobody is to watch.

    Raises:
        InputError: It cannot be opened.
    """
    if not foxglove and port is None:
        return None
    option = "--foxglove" if port is None else "--foxglove-port"
    port = live.PORT if port is None else port
    live.check_port(port, option)
    print(f"live: ws://{live.HOST}:{port}, for Foxglove and Lichtblick", file=sys.stderr)
    return port


def _over(
    opened: Session,
    choice: BusChoice,
    directory: Path,
    private: Path,
    path: Path,
    lockstep: bool,
    frames: bool,
    json: bool,
    live_port: int | None,
    view: bool,
) -> Ended:
    """Open the buses, run, and close them."""
    buses = RigBuses(bus_names(opened.robot.joint_config), opened.scenario.bus, choice)

    def abandon() -> None:
        """What is left to do for the rig when this process was killed."""
        buses.release()
        with contextlib.suppress(OSError):
            private.rmdir()

    try:
        buses.open(directory)
        where = {
            "unix": f" (sockets in {directory})",
            "vcan": f" (dftc fault --bus-dir {private})",
        }.get(choice.kind, "")
        print(f"bus: {choice.reason}{where}", file=sys.stderr, flush=True)
        with Status(opened, quiet=json or lockstep) as status:
            asks = directory if choice.kind == "unix" else private
            return _launch(
                opened,
                choice,
                buses,
                path,
                lockstep,
                frames,
                status,
                abandon,
                live_port,
                asks,
                view,
            )
    finally:
        buses.release()


def _launch(
    opened: Session,
    choice: BusChoice,
    buses: RigBuses,
    path: Path,
    lockstep: bool,
    frames: bool,
    status: Status,
    abandon: Callable[[], None],
    live_port: int | None,
    asks: Path,
    view: bool,
) -> Ended:
    """Run the processes; the rig takes faults in the directory ``asks``."""
    rings, flags = Rings.create(opened, frames=frames), Flags()
    epoch_ns = 0 if lockstep else time.time_ns()
    names = bus_names(opened.robot.joint_config)

    def in_process() -> Sequence[FrameSocket]:
        motion = np.empty((3, opened.robot.n))
        opened.parts.reference.target(0.0, motion)
        made = in_process_rig(
            opened.scenario, opened.robot, motion, rings.rig, rings.events[1].write,
            None if lockstep else time.monotonic_ns,
        )  # fmt: skip
        return made.sockets

    def over_buses() -> Sequence[FrameSocket]:
        buses.let_go()
        roles.await_rig(flags)
        directory = buses.directory.path if buses.directory is not None else None
        return join(names, choice, directory, fd_bitrate(opened.scenario.bus) is not None)

    def build() -> tuple[Rig, Sequence[BusPort]]:
        ports = buses.ports()
        return make_rig(opened, ports, rings.rig, rings.events[1].write), ports

    alone = choice.kind == "inprocess"

    def attend(made: Rig) -> FaultDesk:
        return roles.take_faults(made, opened, asks, rings.events[1].write)

    watchdog_s = opened.scenario.rig.drive.watchdog_s
    return Launcher(
        rings,
        flags,
        functools.partial(
            roles.controller, opened, in_process if alone else over_buses, rings, flags,
            lockstep=lockstep,
        ),
        None if alone else functools.partial(
            roles.rig, opened, build, rings, flags, abandon, attend, lockstep=lockstep
        ),
        lambda file: roles.recorder(
            opened, file, epoch_ns, rings, with_rig=True, live_port=live_port
        ),
        path,
        status.watch,
        crash_s=0.0 if lockstep else watchdog_s + _CRASH_MARGIN_S,
        real_time=not lockstep,
        view=functools.partial(
            roles.view, opened, rings, flags, None if alone else asks
        ) if view else None,
    ).run()  # fmt: skip


def outcome_of(ended: Ended) -> Outcome:
    """Return how the run ended, whoever ended it."""
    report = ended.controller
    if "outcome" in report:
        raw = report["outcome"]
        return Outcome(raw["end_state"], raw["reason"], Counters(**raw["counters"]))
    if ended.interrupted and "exit_code" in report:
        return Outcome("interrupted", "stopped before the drives were armed")
    return Outcome("failed", report.get("error", "the controller ended without a word"))


def finish(opened: Session, ended: Ended, *, report: bool, json: bool) -> int:
    """Print what happened, write the report, and return the exit code."""
    outcome = outcome_of(ended)
    report_refused("controller", ended.controller.get("refused", []))
    report_refused("rig", ended.rig.get("refused", []))
    for line in ended.trouble:
        print(line, file=sys.stderr)
    if outcome.end_state == "failed":
        print(outcome.reason, file=sys.stderr)
    code = session.exit_code(outcome.end_state)
    if outcome.end_state == "failed":
        code = int(ended.controller.get("exit_code", 1))
    logs = [path for path in ended.logs if path.exists()] or ended.logs[:1]
    facts: dict[str, Any] = {
        "log": str(logs[0]),
        "logs": [str(path) for path in logs],
        "recorder_dropped": ended.recorder.get("dropped", {}),
        "buses": ended.rig.get("buses", {}),
    }
    try:
        run, note = read_pieces(logs)
        found = session.summarise(run, outcome, **facts)
    except DftcError as error:
        if outcome.reason and outcome.end_state != "failed":
            print(f"{outcome.end_state}: {outcome.reason}", file=sys.stderr)
        unarmed = outcome.end_state == "interrupted" and not outcome.counters.cycles
        print(f"no summary: {'no cycle was run' if unarmed else error}", file=sys.stderr)
        return code or 1
    if note:
        print(note, file=sys.stderr)
    if ended.recorder_failed:
        code = code or int(ended.recorder.get("exit_code", 1))
    html = ended.logs[0].with_suffix(".html")
    if report:
        try:
            write_report(run, found, html)
            found["report"] = str(html)
        except DftcError as error:  # the run is over: its summary is still worth having
            print(f"no report: {error}", file=sys.stderr)
            code = code or 1
    session.show(found, json)
    if not json:
        print("\n".join(f"{'log:' if path is logs[0] else '':8}{path}" for path in logs))
        if "report" in found:
            print(f"report: {found['report']}")
    if outcome.reason and outcome.end_state != "failed":
        print(f"{outcome.end_state}: {outcome.reason}", file=sys.stderr)
    return code
