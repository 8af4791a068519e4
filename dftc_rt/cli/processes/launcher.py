"""The launcher: owns memory, sockets and signals, and outlives the other processes.

It starts recorder, rig and controller, turns SIGINT and SIGTERM into a safe stop, starts
another recorder when one dies, waits for the controller, ends the rest in order, cleans
up, and knows how it all ended.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dftc_rt.cli.interruption import stop_requests
from dftc_rt.cli.processes.child import Child, Flags
from dftc_rt.cli.processes.roles import Rings
from dftc_rt.rt.executor import ERROR

_LOOK_S = 0.05
_END_PATIENCE_S = 5.0
_STOP_PATIENCE_S = 10.0
_RECORDERS = 5
_VIEW_PATIENCE_S = 0.5
_HANG_S = 2.0  # of a process that does nothing any more

Function = Callable[[], dict[str, Any]]


@dataclass
class Ended:
    """How the processes ended.

    Attributes:
        controller: The controller's report, with ``error`` when it failed.
        rig: The rig's report.
        recorder: The last recorder's report.
        logs: Files written; more than one when a recorder had to be started again.
        trouble: One line for each thing that went wrong besides.
        interrupted: Whether the operator stopped the run.
        rig_failed: The rig ended before the controller.
        recorder_failed: No recorder could be kept alive: the log is not whole.
    """

    controller: dict[str, Any] = field(default_factory=dict)
    rig: dict[str, Any] = field(default_factory=dict)
    recorder: dict[str, Any] = field(default_factory=dict)
    logs: list[Path] = field(default_factory=list)
    trouble: list[str] = field(default_factory=list)
    interrupted: bool = False
    rig_failed: bool = False
    recorder_failed: bool = False


class _Progress:
    """Tells a count that stands still from one that goes on."""

    def __init__(self) -> None:
        self._count, self._since = -1, 0.0

    def stands(self, count: int, should_move: bool) -> bool:
        """Return whether a count that should move has been the same for too long."""
        now = time.monotonic()
        if count != self._count or not should_move:
            self._count, self._since = count, now
        return now - self._since > _HANG_S


class Launcher:
    """Runs controller, rig and recorder as processes of their own."""

    def __init__(
        self,
        rings: Rings,
        flags: Flags,
        controller: Function,
        rig: Function | None,
        recorder: Callable[[Path], dict[str, Any]],
        log: Path,
        watch: Callable[[Rings], None],
        crash_s: float = 0.0,
        real_time: bool = True,
        view: Function | None = None,
    ) -> None:
        """Prepare; :meth:`run` starts.

        Args:
            rings: Shared memory of the run.
            flags: Shared flags.
            controller: Runs in ``dftc-controller``.
            rig: Runs in ``dftc-rig``; None when there is none of its own.
            recorder: Runs in ``dftc-recorder``, given the file to write.
            log: First file.
            watch: Called a few times a second while the controller runs.
            crash_s: How long the rig goes on without a controller that was killed in its
                loop or lost a bus, s: the drives' watchdogs act, and the log shows it.
            real_time: Whether a controller that makes no cycle for long hangs, and a rig that
                somebody has stopped is not waited for.
            view: Runs in ``dftc-view``; None: no page. Whatever becomes of it, the run goes on.
        """
        self._rings = rings
        self._flags = flags
        self._roles = (controller, rig, recorder)
        self._view_role = view
        self._view_told = False
        self._log = log
        self._watch = watch
        self._crash_s = crash_s
        self._ended = Ended()
        self._requested_at = 0.0
        self._real_time = real_time
        self._cycles = _Progress()
        self._logged = _Progress()
        self._rig_lives = _Progress()

    def run(self) -> Ended:
        """Start everything, wait for the controller's end, and end everything."""
        with stop_requests(self._ask_to_stop):
            return self._run()

    def _run(self) -> Ended:
        controller_role, rig_role, recorder_role = self._roles
        children: list[Child] = []
        try:
            recorder = self._start_recorder(recorder_role)
            children.append(recorder)
            rig = Child("dftc-rig", rig_role) if rig_role is not None else None
            if rig is not None:
                children.append(rig)
            controller = Child("dftc-controller", controller_role)
            children.append(controller)
            view = Child("dftc-view", self._view_role) if self._view_role is not None else None
            if view is not None:
                children.append(view)
            while controller.poll() is None:
                time.sleep(_LOOK_S)
                if view is not None:
                    self._look_at(view)
                if self._flags.stop and not self._requested_at:  # the page has asked for it
                    self._requested_at = time.monotonic()
                if rig is not None and not self._ended.rig_failed:
                    self._look_at_rig(rig)
                recorder = self._keep_recording(recorder, recorder_role, children)
                self._watch(self._rings)
                if self._real_time and self._cycles.stands(
                    self._rings.cycle.written + self._rings.cycle.dropped,
                    self._flags.running or controller.stopped,
                ):
                    self._trouble(f"dftc-controller made no cycle for {_HANG_S:g} s")
                    controller.kill()
                if self._requested_at and time.monotonic() - self._requested_at > _STOP_PATIENCE_S:
                    self._trouble("dftc-controller did not stop when asked; it was killed")
                    controller.kill()
            if view is not None:
                self._close(view)
            self._ended.controller = controller.report
            if "error" in controller.report:  # it could not log this itself
                self._log_error(controller.report["error"])
            if self._flags.running or controller.report.get("bus_lost"):
                time.sleep(self._crash_s)
            self._rings.end_controller()
            self._flags.end = True
            if rig is not None:
                self._ended.rig = self._finish(rig)
            self._rings.rig.end()
            for ring in self._rings.events:
                ring.end()
            self._ended.recorder = self._finish(recorder)
            if recorder.code and self._left() and len(self._ended.logs) < _RECORDERS:
                recorder = self._start_recorder(recorder_role)  # for what the last one left
                children.append(recorder)
                self._ended.recorder = self._finish(recorder)
            self._ended.recorder_failed |= bool(recorder.code)
        except BaseException:
            self._come_to_rest(children)  # whatever went wrong here, the robot is not dropped
            raise
        finally:
            for child in children:
                child.kill()
        return self._ended

    def _look_at_rig(self, rig: Child) -> None:
        """End the run when the rig has ended, or stands still.

        In the loop the controller finds a stopped rig by itself, and sooner. Before it, it
        waits for the rig to be built, which may take minutes where kernels are compiled: then
        nothing else tells a rig that compiles from one that was stopped.
        """
        waiting = self._real_time and not self._flags.running
        if self._rig_lives.stands(0, waiting and rig.stopped):
            self._trouble(f"dftc-rig was stopped for {_HANG_S:g} s; it was killed")
            rig.kill()
        elif rig.poll() is None:
            return
        else:
            self._trouble(rig.report.get("error", "dftc-rig ended early"))
        self._ended.rig_failed = True
        self._flags.end = True
        self._flags.stop = True

    def _look_at(self, view: Child) -> None:
        """Say once that the page has gone or stands still; nothing else follows from it."""
        if self._view_told:
            return
        if view.poll() is not None:
            why = view.report.get("error", "dftc-view ended early")
        elif view.stopped:
            why = "dftc-view was stopped"
        else:
            return
        self._view_told = True
        self._trouble(f"{why}; the run goes on without its page")

    def _close(self, view: Child) -> None:
        """End the page: it has nothing to lose, so it is not waited for."""
        view.terminate()
        deadline = time.monotonic() + _VIEW_PATIENCE_S
        while view.poll() is None and time.monotonic() < deadline:
            time.sleep(0.005)
        view.kill()

    def _keep_recording(
        self, recorder: Child, role: Callable[[Path], dict[str, Any]], children: list[Child]
    ) -> Child:
        """Return the recorder, or another where it has ended or does nothing any more."""
        ring = self._rings.cycle
        if self._logged.stands(ring.written - ring.pending, ring.pending > 0):
            recorder.kill()
        if recorder.poll() is None or self._ended.recorder_failed:
            return recorder
        why = recorder.report.get("error", "dftc-recorder ended early")
        if len(self._ended.logs) == _RECORDERS:
            self._trouble(f"{why}; nothing is logged any more")
            self._ended.recorder_failed = True
            return recorder
        self._trouble(f"{why}; another one goes on")
        self._logged = _Progress()
        another = self._start_recorder(role)
        children.append(another)
        return another

    def _left(self) -> int:
        """Return how many records and events nobody has logged."""
        rings = (self._rings.cycle, self._rings.rig, *self._rings.events)
        return sum(ring.pending for ring in rings)

    def _come_to_rest(self, children: list[Child]) -> None:
        """Ask the controller for a safe stop, and give it the time."""
        self._flags.stop = True
        deadline = time.monotonic() + _STOP_PATIENCE_S
        alive = [child for child in children if child.name == "dftc-controller"]
        while any(child.poll() is None for child in alive) and time.monotonic() < deadline:
            time.sleep(_LOOK_S)

    def _start_recorder(self, role: Callable[[Path], dict[str, Any]]) -> Child:
        logs, path, number = self._ended.logs, self._log, 1
        while path in logs or (number > 1 and os.path.lexists(path)):  # an earlier run's stays
            number += 1
            path = self._log.with_suffix(f".{number}.mcap")
        logs.append(path)
        return Child("dftc-recorder", lambda: role(path))

    def _finish(self, child: Child) -> dict[str, Any]:
        """Wait for a child that should end by itself now; kill it when it does not."""
        deadline = time.monotonic() + _END_PATIENCE_S
        while child.poll() is None:
            if time.monotonic() > deadline:
                self._trouble(f"{child.name} did not end; it was killed")
                child.kill()
                break
            time.sleep(0.005)
        if "error" in child.report and not (child.name == "dftc-rig" and self._ended.rig_failed):
            self._trouble(child.report["error"])
        return child.report

    def _trouble(self, text: str) -> None:
        self._ended.trouble.append(text)
        self._log_error(text)

    def _log_error(self, text: str) -> None:
        self._rings.events[2].write(self._now(), ERROR, "launcher", text)

    def _now(self) -> float:
        newest = self._rings.cycle.latest()
        return float(newest[0]) if newest is not None else 0.0

    def _ask_to_stop(self) -> None:
        self._ended.interrupted = True
        self._flags.stop = True
        if not self._requested_at:
            self._requested_at = time.monotonic()
