"""What each child process of a run does, as plain functions."""

from __future__ import annotations

import dataclasses
import mmap
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.interface import FrameSocket
from dftc_rt.cli.processes.child import Flags, on_sigterm
from dftc_rt.cli.session import Session, ending
from dftc_rt.controller import connect
from dftc_rt.errors import BusError
from dftc_rt.log.ending import SOURCE
from dftc_rt.log.process import record
from dftc_rt.ring import EventRing, Ring
from dftc_rt.rt.clock import Clock, LockstepClock, RealClock
from dftc_rt.rt.executor import ERROR, INFO
from dftc_rt.rt.process import RealTime, first_core, last_core, stand_back
from dftc_rt.view.run import LiveRun
from hil.bus.port import BusPort
from hil.bus.statistics import TOTALS, busy_s
from hil.fault_desk import FaultDesk
from hil.loop import run_lockstep, run_wall
from hil.rig import EventFunction, Rig

CONTROLLER_PRIORITY = 80
# Equal, on one core: the controller sends SYNC on all its buses and blocks, then the rig
# serves them in one go. Above it, the rig would wake up for each bus; below, it would be
# starved by a controller that spins.
RIG_PRIORITY = 80
_ORPHAN_PATIENCE_S = 3.0
_LOOK_S = 0.005


@dataclasses.dataclass(frozen=True)
class Rings:
    """Shared memory of a run.

    Attributes:
        cycle: The controller's records.
        rig: The rig's records.
        events: One ring a writer: controller, rig, launcher.
        frames: Every frame that passes the controller's sockets; None when not logged.
        traffic: What the rig's buses count, a row a bus, the columns of
            :mod:`hil.bus.statistics`; zero without a rig.
    """

    cycle: Ring
    rig: Ring
    events: tuple[EventRing, EventRing, EventRing]
    frames: Ring | None = None
    traffic: NDArray[np.int64] = dataclasses.field(default_factory=lambda: _shared_counts(0))

    @classmethod
    def create(cls, opened: Session, *, frames: bool = False) -> Rings:
        """Make the rings; at 1 kHz they hold eight seconds.

        Args:
            opened: The session.
            frames: Whether frames are logged.
        """
        # A command and two answers of a joint, SYNC and one answer more of a bus, each cycle.
        a_cycle = 3 * opened.robot.n + 2 * len(opened.can.buses)
        return cls(
            Ring.create("dftc-cycle", 8192, opened.cycle.size),
            Ring.create("dftc-rig", 8192, opened.rig.size),
            (
                EventRing.create("dftc-events-controller"),
                EventRing.create("dftc-events-rig"),
                EventRing.create("dftc-events-launcher"),
            ),
            Ring.create("dftc-can", 8192 * a_cycle, opened.can.size) if frames else None,
            _shared_counts(len(opened.can.buses)),
        )

    def end_controller(self) -> None:
        """Say that nothing more will come from the controller."""
        self.cycle.end()
        self.events[0].end()
        if self.frames is not None:
            self.frames.end()


def _shared_counts(buses: int) -> NDArray[np.int64]:
    """Zeros in memory that forked processes share, shape ``(buses, 7)``."""
    page = mmap.mmap(-1, max(buses, 1) * TOTALS * 8)
    return np.frombuffer(page, np.int64, buses * TOTALS).reshape(buses, TOTALS)


def controller(
    opened: Session,
    connect_buses: Callable[[], Sequence[FrameSocket]],
    rings: Rings,
    flags: Flags,
    *,
    lockstep: bool,
) -> dict[str, Any]:
    """Run the controller; the whole of ``dftc-controller``.

    Args:
        opened: The session.
        connect_buses: Opens the controller's sockets, in the order of ``bus_names``.
        rings: Where records and events go.
        flags: ``stop`` asks for a safe stop.
        lockstep: No waiting, no real-time settings.

    Returns:
        The outcome, what the system refused, and whether a bus went away.
    """

    def stop() -> None:
        flags.stop = True

    on_sigterm(stop)
    events = rings.events[0]
    clock: Clock = LockstepClock() if lockstep else RealClock()
    refused: list[str] = []
    real_time: RealTime | None = None
    try:
        executor = connect(
            opened.scenario, opened.parts, connect_buses(), clock, rings.cycle, events.write,
            lambda: flags.stop, rings.frames,
        )  # fmt: skip
        if not lockstep:
            real_time = RealTime(CONTROLLER_PRIORITY, last_core())
            refused = real_time.refused
        flags.running = True
        bus_lost = False
        try:
            outcome = executor.run()
        except BusError as error:
            bus_lost = True
            outcome = executor.outcome
            outcome.end_state, outcome.reason = "safe stop", f"bus lost: {error}"
            events.write(executor.t, ERROR, SOURCE, f"safe stop: {outcome.reason}")
        events.write(executor.t, INFO, SOURCE, ending(outcome))
    finally:
        flags.running = False
        rings.end_controller()
        if real_time is not None:
            real_time.release()
    return {"outcome": dataclasses.asdict(outcome), "refused": refused, "bus_lost": bus_lost}


def rig_core(opened: Session) -> int:
    """Return the core of the rig in wall time: the controller's, but not where frames take time.

    A paced bus delivers each frame when it is through, whatever the controller does meanwhile.
    """
    return first_core() if opened.scenario.bus.timing == "pace" else last_core()


def await_rig(flags: Flags) -> None:
    """Wait until the rig answers: on a fresh machine it compiles its kernels first.

    Raises:
        BusError: The rig has ended, or the operator wants to stop.
    """
    while not flags.serving:
        if flags.end or flags.stop:
            raise BusError("rig", "ended before the drives answered")
        time.sleep(_LOOK_S)


def rig(
    opened: Session,
    build: Callable[[], tuple[Rig, Sequence[BusPort]]],
    rings: Rings,
    flags: Flags,
    clean_up: Callable[[], object],
    attend: Callable[[Rig], FaultDesk],
    *,
    lockstep: bool,
) -> dict[str, Any]:
    """Run the rig; the whole of ``dftc-rig``.

    Args:
        opened: The session.
        build: Makes the rig and its ports.
        rings: Where records and events go.
        flags: ``end`` asks the rig to end.
        clean_up: Called at the end when the launcher, whose work it is, was killed.
        attend: Has it take faults while it runs: :func:`take_faults`.
        lockstep: Rig time moves by barriers only; no real-time settings.

    Returns:
        What happened on the buses, and what the system refused.
    """
    orphaned_at = [0.0]

    def orphaned() -> None:
        # The launcher has gone. The controller stops safely by itself and needs us for it.
        orphaned_at[0] = time.monotonic()

    def ended() -> bool:
        return flags.end or (
            orphaned_at[0] > 0.0 and time.monotonic() - orphaned_at[0] > _ORPHAN_PATIENCE_S
        )

    on_sigterm(orphaned)
    refused: list[str] = []
    real_time: RealTime | None = None
    ports: Sequence[BusPort] = ()
    desk: FaultDesk | None = None
    try:
        made, ports = build()
        for port, totals in zip(ports, rings.traffic, strict=True):
            port.count_into(totals)
        desk = attend(made)
        if not lockstep:
            real_time = RealTime(RIG_PRIORITY, rig_core(opened))
            refused = real_time.refused
        flags.serving = True
        if lockstep:
            run_lockstep(made, ports, ended)
        else:
            run_wall(made, ports, ended)
        return {
            "refused": refused,
            "stalls": made.stalls,
            "faults_refused": desk.refused,
            "buses": {port.name: dataclasses.asdict(port.statistics) for port in ports},
        }
    finally:
        rings.rig.end()
        rings.events[1].end()
        for port in ports:
            port.close()
        if desk is not None:
            desk.close()
        if orphaned_at[0]:
            clean_up()
        if real_time is not None:
            real_time.release()


def take_faults(
    made: Rig,
    opened: Session,
    directory: Path,
    event: EventFunction,
) -> FaultDesk:
    """Have a rig take faults while it runs.

    Args:
        made: The rig.
        opened: The session.
        directory: Where the socket for faults is to lie.
        event: Takes events.

    Returns:
        What takes them; to be closed.

    Raises:
        InputError: The socket cannot be made.
    """
    desk = FaultDesk(directory, opened.scenario.fault, made.change_faults, event)

    made.each_step = desk.take
    return desk


def view(
    opened: Session,
    rings: Rings,
    flags: Flags,
    directory: Path | None,
) -> dict[str, Any]:
    """Serve the page; the whole of ``dftc-view``.

    Args:
        opened: The session.
        rings: What is read, and never drained: that is the recorder's.
        flags: ``stop`` asks for a safe stop.
        directory: Where the rig takes faults; None: it takes none.

    Raises:
        EnvironmentLacksError: viser is not installed.
    """
    from dftc_rt.view.live import LivePage  # after the fork: nobody else needs it

    ended: list[int] = []
    on_sigterm(lambda: ended.append(1))
    stand_back()

    def stop() -> None:
        flags.stop = True

    def busy() -> NDArray[np.float64]:
        newest, bus = rings.rig.latest(), opened.scenario.bus
        told = busy_s(rings.traffic, bus.bitrate, bus.data_bitrate)
        t = 0.0 if newest is None else newest[0]
        return np.column_stack([np.where(told > 0.0, t, 0.0), told])

    run = LiveRun(opened.robot, rings.cycle.latest, rings.rig.latest, opened.can.buses, busy)
    page = LivePage(opened.scenario.name, run, stop, directory)
    print(f"view: {page.url}", file=sys.stderr, flush=True)
    if page.note:
        print(f"view: {page.note}", file=sys.stderr, flush=True)
    page.serve(lambda: bool(ended))
    return {}


def recorder(
    opened: Session,
    path: Path,
    epoch_ns: int,
    rings: Rings,
    *,
    with_rig: bool,
    live_port: int | None = None,
) -> dict[str, Any]:
    """Drain the rings into the log; the whole of ``dftc-recorder``.

    Args:
        opened: The session.
        path: File to write.
        epoch_ns: Unix time of t = 0, ns.
        rings: What to drain.
        with_rig: Whether there is a rig whose truth is logged.
        live_port: Port of this machine for viewers; None: none.

    Returns:
        Counts, and records dropped by ring.

    Raises:
        LogError: The file cannot be written.
        EnvironmentLacksError: The disk is full.
    """
    orphaned_at = [0.0]

    def orphaned() -> None:
        orphaned_at[0] = time.monotonic()

    def stop() -> bool:
        return orphaned_at[0] > 0.0 and time.monotonic() - orphaned_at[0] > _ORPHAN_PATIENCE_S

    on_sigterm(orphaned)
    frames = rings.frames
    with opened.recorder(
        path, epoch_ns, with_rig=with_rig, with_frames=frames is not None, live_port=live_port
    ) as log:
        truth = rings.rig if with_rig else None
        done = record(rings.cycle, truth, rings.events, log, stop, frame_ring=frames)
    return dataclasses.asdict(done)
