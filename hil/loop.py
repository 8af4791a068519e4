"""The rig's own loop: wait for frames, serve them, and let time pass without them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from dftc_rt.bus.wait import Waiter
from hil.bus.port import BusPort
from hil.rig import Rig

_LOOK_S = 0.1  # how often a lock-step rig looks whether it should end


def _watch(ports: Sequence[BusPort]) -> tuple[Waiter, int]:
    return Waiter([fd for port in ports for fd in port.fds()]), _version(ports)


def _version(ports: Sequence[BusPort]) -> int:
    return sum(port.fds_version for port in ports)


def run_lockstep(rig: Rig, ports: Sequence[BusPort], ended: Callable[[], bool]) -> None:
    """Serve in lock-step until ``ended``; waiting never moves rig time.

    Raises:
        BusError: A bus has gone away.
    """
    waiter, version = _watch(ports)
    while not ended():
        rig.service_lockstep()
        if _version(ports) != version:
            waiter, version = _watch(ports)
        waiter.wait(_LOOK_S)
    rig.service_lockstep()


def run_wall(rig: Rig, ports: Sequence[BusPort], ended: Callable[[], bool]) -> None:
    """Serve in wall time until ``ended``.

    Raises:
        BusError: A bus has gone away.
    """
    waiter, version = _watch(ports)
    while not ended():
        patience = rig.patience_s
        came = waiter.wait(patience)
        now = time.monotonic_ns()
        if came:
            rig.service_wall(now)
            if _version(ports) != version:
                waiter, version = _watch(ports)
        if rig.overdue(now):
            rig.idle_wall(now)
