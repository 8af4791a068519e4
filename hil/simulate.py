"""Controller and rig in one process, joined by in-process links, in lock-step."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dftc_rt.bus.interface import FrameSocket
from dftc_rt.config.scenario import Scenario
from dftc_rt.drives.wiring import bus_names, fd_bitrate
from dftc_rt.dynamics.model import Robot
from hil.bus.inprocess import InProcessPort
from hil.bus.virtual_bus import unpaced
from hil.rig import EventFunction, RecordSink, Rig, initial_state


@dataclass
class InProcessRig:
    """A rig that is served from inside the controller's sends.

    Attributes:
        rig: The rig.
        sockets: The controller's ends, one a bus.
    """

    rig: Rig
    sockets: list[FrameSocket]


def in_process_rig(
    scenario: Scenario,
    robot: Robot,
    on_reference: np.ndarray,
    sink: RecordSink,
    event: EventFunction,
    clock: Callable[[], int] | None = None,
) -> InProcessRig:
    """Build a rig and links to it.

    Args:
        scenario: The resolved scenario.
        robot: What the controller believes.
        on_reference: Desired position and velocity at t = 0, (2+, n).
        sink: Takes one record a step.
        event: Takes events.
        clock: Wall time in ns for a rig in wall time; None for lock-step.

    Raises:
        InputError: A value of ``[rig]`` or a fault does not fit the robot.
    """
    ports = [
        InProcessPort(
            name,
            timing=unpaced(scenario.bus.timing),
            bitrate=scenario.bus.bitrate,
            data_bitrate=fd_bitrate(scenario.bus),
        )
        for name in bus_names(robot.joint_config)
    ]
    nodes = [port.connect() for port in ports]
    q0, v0 = initial_state(scenario, robot, on_reference)
    rig = Rig(scenario, robot, ports, q0, v0, sink, event)
    for bus, node in enumerate(nodes):
        if clock is None:
            node.service = functools.partial(rig.service_lockstep, (bus,))
        else:
            node.service = functools.partial(_serve_wall, rig, clock, (bus,))
    return InProcessRig(rig, list(nodes))


def _serve_wall(rig: Rig, clock: Callable[[], int], ready: tuple[int, ...]) -> None:
    rig.service_wall(clock(), ready)
