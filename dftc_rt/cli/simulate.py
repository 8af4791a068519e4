"""``dftc simulate``: the closed loop in one process, as fast as it goes."""

from __future__ import annotations

import dataclasses
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import FrameType

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from dftc_rt.bus.interface import FrameSocket
from dftc_rt.cli import session
from dftc_rt.cli.interruption import stop_requests
from dftc_rt.cli.output import log_file
from dftc_rt.cli.session import Session
from dftc_rt.controller import connect
from dftc_rt.errors import BusError, InputError
from dftc_rt.log.ending import SOURCE
from dftc_rt.log.process import drain_frames
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.run import Run
from dftc_rt.memory import MemorySink
from dftc_rt.ring import Event, Ring
from dftc_rt.rt.clock import LockstepClock
from dftc_rt.rt.executor import INFO, Outcome
from hil.bus.virtual_bus import unpaced
from hil.simulate import in_process_rig

_DRAIN_EVERY = 512
_PROGRESS_EVERY = 256
_FRAMES = 16384  # kept between drains; half of them hold any cycle, and any set-up


class _DrainingSink(MemorySink):
    """Memory that also hands its records on, a few hundred at a time."""

    def __init__(self, width: int, write: Callable[[NDArray[np.float64]], None]) -> None:
        super().__init__(width)
        self._write = write
        self._fresh = 0

    def commit(self) -> bool:
        super().commit()
        self._fresh += 1
        if self._fresh == _DRAIN_EVERY:
            self.flush()
        return True

    def flush(self) -> None:
        """Hand on what is left."""
        self._fresh = 0
        while len(block := self.drain()):
            self._write(block)


def simulate(
    scenario: str | Path,
    *,
    log: str | Path | None = None,
    set_: Sequence[str] = (),
    frames: bool = False,
    json: bool = False,
) -> int:
    """Run controller and rig in one process, in lock-step, as fast as it goes.

    The same scenario and seed give the same records, byte for byte (the wall-time fields
    lateness, compute and exchange apart).

    Example::

        dftc simulate panda_shoulder_loss --set fault[0].effectiveness=0.5

    Args:
        scenario: Scenario file, or the name of a shipped one.
        log: Write the run to this MCAP file.
        set_: Override a key, ``a.b=value``; may be repeated.
        frames: Log every frame that the controller sends and receives, to /can.
        json: Print one JSON object on stdout.

    Returns:
        Exit code.

    Raises:
        InputError: The scenario is wrong, or the log cannot be written.
    """
    if frames and log is None:
        raise InputError("--frames", "no log to put them in", "--log F.mcap besides")
    opened = session.open_session(scenario, set_)
    unpaced(opened.scenario.bus.timing)
    with log_file(opened, log) if log is not None else nullcontext():
        warm_up(opened)
        recorder = None
        if log is not None:
            recorder = opened.recorder(log, epoch_ns=0, with_frames=frames)
        with recorder or nullcontext():
            run, outcome = run_simulation(opened, recorder, frames=frames)
    found = session.summarise(run, outcome, log=None if log is None else str(log))
    session.show(found, json)
    if outcome.reason:
        print(f"dftc: {outcome.end_state}: {outcome.reason}", file=sys.stderr)
    return session.exit_code(outcome.end_state)


def run_simulation(
    opened: Session,
    recorder: Recorder | None = None,
    *,
    progress: bool = True,
    abort: bool = False,
    frames: bool = False,
) -> tuple[Run, Outcome]:
    """Run a session to its end; SIGINT and SIGTERM stop it safely.

    Args:
        opened: From :func:`dftc_rt.cli.session.open_session`.
        recorder: Also write the run here.
        progress: Show a progress bar on a terminal.
        abort: End by KeyboardInterrupt when asked to stop, and do not wait for a compiler.
        frames: Write every frame too; needs a recorder that has a layout of frames.

    Raises:
        DriveError: A drive refuses its set-up.
        KeyboardInterrupt: It was asked to stop, with ``abort``.
    """
    events: list[Event] = []

    def event(t: float, severity: int, source: str, text: str) -> None:
        events.append(Event(t, severity, source, text))
        if recorder is not None:
            recorder.write_event(t, severity, source, text)

    def sink(width: int, write: Callable[[NDArray[np.float64]], None] | None) -> MemorySink:
        return MemorySink(width) if write is None else _DrainingSink(width, write)

    cycles = sink(opened.cycle.size, recorder.write_cycles if recorder else None)
    truth = sink(opened.rig.size, recorder.write_rig if recorder else None)
    motion = np.empty((3, opened.robot.n))
    opened.parts.reference.target(0.0, motion)
    joined = in_process_rig(opened.scenario, opened.robot, motion, truth, event)
    tapped = Ring.create("dftc-can", _FRAMES, opened.can.size) if frames else None

    def log_frames(least: int) -> None:
        if recorder is not None and tapped is not None and tapped.pending >= least:
            drain_frames(tapped, recorder, ending=True)

    stop = _Stop(joined.sockets if abort else ())
    with stop_requests(stop), _Bar(opened, cycles, progress) as tick:

        def stop_requested() -> bool:
            tick()
            log_frames(_FRAMES // 2)
            return stop.requested

        try:
            executor = connect(
                opened.scenario, opened.parts, joined.sockets, LockstepClock(), cycles, event,
                stop_requested, tapped,
            )  # fmt: skip
            outcome = executor.run()
        except BusError:
            if abort and stop.requested:  # the sockets were cut, whatever became of the exception
                raise KeyboardInterrupt from None
            raise
    if abort and stop.requested:  # after the last cycle, too: nobody else has heard of it
        raise KeyboardInterrupt
    event(executor.t, INFO, SOURCE, session.ending(outcome))
    log_frames(0)
    for each in (cycles, truth):
        if isinstance(each, _DrainingSink):
            each.flush()
    run = Run.from_records(
        opened.cycle,
        cycles.records(),
        truth.records(),
        scenario=opened.text,
        events=events,
        torque_limit=opened.parts.torque_limit,
    )
    return run, outcome


def warm_up(opened: Session) -> None:
    """Run a few cycles and forget them, so that everything the run calls is compiled.

    Numba compiles a kernel when it is first called, once per installation, and loads it
    from its cache after that. Done before the processes are forked, it is done for all.

    Raises:
        KeyboardInterrupt: The operator wanted to stop meanwhile.
    """
    table = opened.scenario.bus
    timing = "account" if table.timing == "pace" else table.timing  # no time passes here
    bus = msgspec.structs.replace(table, timing=timing)
    short = msgspec.structs.replace(opened.scenario, duration_s=0.02, bus=bus)
    brief = dataclasses.replace(opened, scenario=short)
    with _SayIfSlow("compiling the kernels; once per installation, this takes a minute or so"):
        run_simulation(brief, progress=False, abort=True)


class _SayIfSlow:
    """Prints a line on standard error if what it surrounds takes long."""

    def __init__(self, line: str) -> None:
        self._timer = threading.Timer(2.5, print, (line,), {"file": sys.stderr, "flush": True})
        self._timer.daemon = True  # not waited for, should a signal leave a lock of its held

    def __enter__(self) -> None:
        self._timer.start()

    def __exit__(self, *_: object) -> None:
        self._timer.cancel()
        self._timer.join()  # no thread is left when a process is forked


class _Stop:
    """A request to stop, which the loop looks at once a cycle.

    With sockets to cut, it also ends a compiler's work, which may take a minute, by an
    exception. Nowhere else: out of nowhere, that may leave a lock held which the set-up's
    own end waits for without end (that of canopen's queue of answers).
    """

    def __init__(self, cut: Sequence[FrameSocket]) -> None:
        self.requested = False
        self._cut = cut

    def __call__(self) -> None:
        self.requested = True
        if self._cut and _compiling():
            for socket in self._cut:  # nothing more is compiled only to take leave
                socket.close()
            raise KeyboardInterrupt


def _compiling() -> bool:
    """Return whether Numba is at work below the caller."""
    frame: FrameType | None = sys._getframe()
    while frame is not None:
        if frame.f_globals.get("__name__", "").startswith("numba."):
            return True
        frame = frame.f_back
    return False


class _Bar(AbstractContextManager[Callable[[], None]]):
    """A progress bar on standard error, moved on now and then."""

    def __init__(self, opened: Session, cycles: MemorySink, wanted: bool) -> None:
        self._cycles = cycles
        self._count = 0
        self._progress: Progress | None = None
        if wanted and sys.stderr.isatty():
            self._progress = Progress(console=Console(stderr=True), transient=True)
            total = opened.scenario.duration_s * opened.scenario.executor.rate_hz
            self._task = self._progress.add_task("simulating", total=total)

    def __enter__(self) -> Callable[[], None]:
        if self._progress is None:
            return _nothing
        self._progress.start()
        return self._tick

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def _tick(self) -> None:
        self._count += 1
        if self._count % _PROGRESS_EVERY == 0 and self._progress is not None:
            self._progress.update(self._task, completed=self._count)


def _nothing() -> None:
    """No bar: nothing to move on."""
