"""Time of the rig's own work: one process holds both ends of the buses, and serves them.

``dftc hil`` records the exchange as the controller sees it, which holds the rig's answer
to SYNC. Here the same rig is called from the controller's sends, over the same AF_UNIX
sockets and at the same pace, so that its share can be timed by itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus import unix
from dftc_rt.bus.frame import Frames
from dftc_rt.cli.session import Session, open_session
from dftc_rt.controller import connect
from dftc_rt.drives.wiring import bus_names
from dftc_rt.memory import MemorySink
from dftc_rt.rt.clock import RealClock
from dftc_rt.rt.process import RealTime, last_core
from hil.bus.virtual_bus import VirtualBus, unpaced
from hil.rig import Rig, initial_state

PRIORITY = 80


class ServedSocket(unix.UnixSocket):
    """The controller's end of a bus; what it sends is served before ``send`` returns."""

    __slots__ = ("serve",)

    serve: Callable[[], None]

    def send(self, frames: Frames, count: int) -> int:
        """Send, and have the rig look."""
        sent = super().send(frames, count)
        self.serve()
        return sent


class Joined:
    """A rig and the controller's sockets, in one process.

    Attributes:
        rig: The rig.
        sockets: The controller's ends, one a bus.
        on_sync: Time of each service that answered a SYNC, ns.
        on_commands: Time of each service of commands, ns: it also integrates the plant ahead.
    """

    def __init__(self, opened: Session) -> None:
        import socket

        self.sockets: list[ServedSocket] = []
        self.on_sync: list[int] = []
        self.on_commands: list[int] = []
        ports = []
        for name in bus_names(opened.robot.joint_config):
            near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            port = VirtualBus(name, timing=unpaced(opened.scenario.bus.timing))
            port.attach(unix.UnixSocket(name, far))
            ports.append(port)
            self.sockets.append(ServedSocket(name, near))
        motion = np.empty((3, opened.robot.n))
        opened.parts.reference.sample(0.0, motion)
        q0, v0 = initial_state(opened.scenario, opened.robot, motion)
        sink = MemorySink(opened.rig.size)
        self.rig = Rig(opened.scenario, opened.robot, ports, q0, v0, sink, _ignore)
        for bus, each in enumerate(self.sockets):
            each.serve = self._each(bus)

    def _each(self, bus: int) -> Callable[[], None]:
        return lambda: self.rig.service_wall(time.monotonic_ns(), (bus,))

    def serve_together(self) -> None:
        """From now on serve all buses when the last one is sent to, as ``dftc-rig`` does."""
        every = range(len(self.sockets))
        for each in self.sockets[:-1]:
            each.serve = _nothing
        self.sockets[-1].serve = lambda: self._timed(every)

    def _timed(self, ready: Sequence[int]) -> None:
        steps = self.rig.steps
        started = time.monotonic_ns()
        self.rig.service_wall(started, ready)
        taken = time.monotonic_ns() - started
        (self.on_sync if self.rig.steps > steps else self.on_commands).append(taken)


def measure(
    scenario: str, settings: Sequence[str], *, real_time: bool = True
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Run a scenario in wall time; return the times of the rig's two services, us.

    To be called in a process of its own: the real-time settings stay.

    Args:
        scenario: Name of a shipped scenario.
        settings: Overrides, ``key=value``.
        real_time: Pin the process and raise its priority.
    """
    opened = open_session(scenario, settings)
    joined = Joined(opened)
    cycles = MemorySink(opened.cycle.size)
    executor = connect(
        opened.scenario, opened.parts, joined.sockets, RealClock(), cycles, _ignore, lambda: False
    )
    if real_time:
        RealTime(PRIORITY, last_core())
    joined.serve_together()
    executor.run()
    return np.array(joined.on_sync) / 1e3, np.array(joined.on_commands) / 1e3


def _ignore(*_: object) -> None:
    """No event matters here."""


def _nothing() -> None:
    """Serve nothing yet."""


def main() -> None:
    """Print the medians as one JSON object."""
    import argparse
    import json
    import sys

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario")
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    on_sync, on_commands = measure(options.scenario, options.settings)
    json.dump(
        {
            "sync_p50_us": float(np.median(on_sync)),
            "commands_p50_us": float(np.median(on_commands)),
        },
        sys.stdout,
    )
    print()


if __name__ == "__main__":
    main()
