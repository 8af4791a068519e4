"""What the commands that run a robot share: loading, layouts, the summary at the end."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import llvmlite.binding
import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from dftc_rt.analysis import metrics, summary
from dftc_rt.bus.frame_record import record_data_bytes
from dftc_rt.config.load import load_scenario
from dftc_rt.config.scenario import Scenario
from dftc_rt.control import signals
from dftc_rt.controller import Parts, prepare, scenario_robot
from dftc_rt.drives.wiring import bus_names, frame_size
from dftc_rt.dynamics.frames import LinkFrames
from dftc_rt.dynamics.model import Robot
from dftc_rt.log.ending import ending_text
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.run import Run
from dftc_rt.log.schema import CanLayout, Layout, cycle_layout, rig_layout
from dftc_rt.replay.stored import files_of
from dftc_rt.rt.executor import Outcome
from hil import SCENARIOS
from hil.rig import check_rig

_PACKAGES = ("dftc_rt", "pin", "numba", "numpy", "canopen", "python-can", "foxglove-sdk")


@dataclass(frozen=True)
class Session:
    """A scenario that has been checked as far as it can be without drives.

    Attributes:
        scenario: The resolved scenario.
        text: The same as TOML.
        robot: The robot.
        parts: The controller's parts.
        cycle: Layout of ``/cycle``.
        rig: Layout of ``/rig``.
        files: What else the controller was made of, for the log.
    """

    scenario: Scenario
    text: str
    robot: Robot
    parts: Parts
    cycle: Layout
    rig: Layout
    files: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def can(self) -> CanLayout:
        """Layout of ``/can``."""
        buses = tuple(bus_names(self.robot.joint_config))
        return CanLayout(buses, record_data_bytes(frame_size(self.scenario.bus)))

    def recorder(
        self,
        path: str | Path,
        epoch_ns: int,
        *,
        with_rig: bool = True,
        with_frames: bool = False,
        notes: Mapping[str, Mapping[str, str]] | None = None,
        live_port: int | None = None,
    ) -> Recorder:
        """Open the log; ``notes`` are further metadata records, on ``live_port`` viewers see it.

        Raises:
            LogError: The file cannot be created.
        """
        frames = LinkFrames(self.robot)

        def link_frames(q: NDArray[np.float64]) -> list[tuple[str, str, list[float], list[float]]]:
            return [
                (t.parent, t.child, t.translation.tolist(), t.quaternion.tolist())
                for t in frames.transforms(q)
            ]

        return Recorder(
            path,
            self.cycle,
            self.rig if with_rig else None,
            self.can if with_frames else None,
            scenario=self.text,
            urdf=self.robot.urdf_xml,
            files=self.files,
            versions=versions(),
            notes=notes,
            torque_limit=self.parts.torque_limit,
            epoch_ns=epoch_ns,
            link_frames=link_frames,
            live_port=live_port,
            live_name=f"dftc {self.scenario.name}",
        )


def open_session(
    scenario: str | Path, settings: Sequence[str] = (), *, identified: bool = True
) -> Session:
    """Load and check a scenario and its robot.

    Args:
        scenario: Scenario file, or the name of a shipped one.
        settings: Overrides, ``a.b=value``.
        identified: Whether its ``control.identification`` is used; the command that makes the
            file leaves it alone.

    Raises:
        InputError: Something in the scenario, the robot or both together is wrong.
    """
    loaded = load_scenario(scenario, settings, SCENARIOS)
    if not identified:
        replace = msgspec.structs.replace
        control = replace(loaded.scenario.control, identification=None)
        loaded = dataclasses.replace(loaded, scenario=replace(loaded.scenario, control=control))
    robot = scenario_robot(loaded.scenario)
    check_rig(loaded.scenario, robot)
    parts = prepare(loaded.scenario, robot)
    return Session(
        loaded.scenario,
        loaded.text,
        robot,
        parts,
        cycle_layout(robot.joints, signals.NAMES),
        rig_layout(robot.joints),
        files_of(loaded.scenario, robot),
    )


def versions() -> dict[str, str]:
    """Return package -> version, for the log's metadata."""
    found = {
        "python": platform.python_version(),
        "kernel": platform.release(),
        "processor": llvmlite.binding.get_host_cpu_name(),  # what kernels are compiled for
    }
    for package in _PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed as a package"
    return found


def summarise(run: Run, outcome: Outcome, **facts: Any) -> dict[str, Any]:
    """Return the metrics of a run as the contract has them, and how it ended."""
    counters = outcome.counters
    return metrics.evaluate(run) | {
        "cycles": counters.cycles,
        "overruns": counters.overruns,
        "missed_answers": counters.missed,
        "end_state": outcome.end_state,
        "reason": outcome.reason,
        **facts,
    }


def ending(outcome: Outcome) -> str:
    """Return the text of the run's last event."""
    return ending_text(outcome.end_state, outcome.reason, dataclasses.asdict(outcome.counters))


def exit_code(end_state: str) -> int:
    """Return the exit code of a run: 0 done, 1 safe stop, 130 interrupted."""
    return {"done": 0, "interrupted": 130}.get(end_state, 1)


def show(found: dict[str, Any], json: bool) -> None:
    """Print the metrics on standard output: one JSON object, or tables for people."""
    if json:
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        summary.show(found, Console(file=sys.stdout))
