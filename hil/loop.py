"""The rig's own loop: wait for frames, serve them, and let time pass without them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from dftc_rt.bus.wait import Waiter
from hil.bus.paced_bus import PacedBus
from hil.bus.port import BusPort
from hil.bus.wire import NEVER
from hil.rig import Rig

_LOOK_S = 0.1  # how often a lock-step rig looks whether it should end


class Watch:
    """Waits for any port; knows which ones have something."""

    def __init__(self, ports: Sequence[BusPort]) -> None:
        """Watch ``ports``, and the clients that come and go on them."""
        self._ports = ports
        self._renew()

    def _renew(self) -> None:
        self._version = _version(self._ports)
        fds: list[int] = []
        self._spans: list[range] = []
        for port in self._ports:
            own = port.fds()
            self._spans.append(range(len(fds), len(fds) + len(own)))
            fds += own
        self._waiter = Waiter(fds)

    def wait(self, timeout_s: float) -> list[int]:
        """Return the indices of the ports that have something to receive."""
        if _version(self._ports) != self._version:
            self._renew()
        if not self._waiter.wait(timeout_s):
            return []
        ready = self._waiter.ready
        return [bus for bus, span in enumerate(self._spans) if any(map(ready, span))]


def _version(ports: Sequence[BusPort]) -> int:
    return sum(port.fds_version for port in ports)


def run_lockstep(rig: Rig, ports: Sequence[BusPort], ended: Callable[[], bool]) -> None:
    """Serve in lock-step until ``ended``; waiting never moves rig time.

    Raises:
        BusError: A bus has gone away.
    """
    watch = Watch(ports)
    while not ended():
        rig.service_lockstep(watch.wait(_LOOK_S))
    rig.service_lockstep(range(len(ports)))


def run_wall(rig: Rig, ports: Sequence[BusPort], ended: Callable[[], bool]) -> None:
    """Serve in wall time until ``ended``.

    Raises:
        BusError: A bus has gone away.
    """
    paced = [port for port in ports if isinstance(port, PacedBus)]
    if paced:
        _run_paced(rig, paced, ended)
        return
    watch = Watch(ports)
    while not ended():
        ready = watch.wait(rig.patience_s)
        now = time.monotonic_ns()
        if ready:
            rig.service_wall(now, ready)
        if rig.overdue(now):
            rig.idle_wall(now)


def _run_paced(rig: Rig, ports: Sequence[PacedBus], ended: Callable[[], bool]) -> None:
    """Serve paced buses: sleep until a client sends or a frame is through.

    The plant is integrated ahead while nothing is on any wire, so that it keeps no frame waiting.
    """
    watch = Watch(ports)
    while not ended():
        left = 1e-9 * (min(port.due for port in ports) - time.monotonic_ns())
        for bus in watch.wait(min(left, rig.patience_s)):
            ports[bus].take_in()
        now = time.monotonic_ns()
        for bus, port in enumerate(ports):
            if port.due <= now:
                rig.service_paced(bus, port)
        if all(port.due == NEVER for port in ports):
            rig.integrate_ahead()
        if rig.overdue(now):
            for port in ports:  # what the drives send now is ready now
                port.take_in()
            rig.idle_wall(now)
