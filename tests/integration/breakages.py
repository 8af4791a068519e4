"""What a command is made to suffer from within, as a bug or a full disk would: see fork_server."""

from __future__ import annotations

import resource
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from dftc_rt.cli.processes import launcher, roles
from dftc_rt.control import signals
from dftc_rt.control.dftc import Dftc
from hil.rig import Rig

AT_CALL = 600  # of the law: well into the motion
AT_STEP = 600  # of the rig
LOG_BYTES = 200_000
JUMP_S = 3600.0


def _law(then: Callable[[Any, int], int | None]) -> None:
    """Let the law do something else from one call on; None: and what it always did."""
    update, calls = Dftc.update, [0]

    def broken(self: Any, rec: Any, inertia: Any, bias: Any, load: Any = None) -> int:
        calls[0] += 1
        status = update(self, rec, inertia, bias, load)
        if calls[0] >= AT_CALL:
            then(rec, calls[0])
        return status

    Dftc.update = broken  # type: ignore[method-assign]


def law_nan() -> None:
    def then(rec: Any, call: int) -> None:
        rec[signals.TAU_CMD, 3] = np.nan

    _law(then)


def law_inf() -> None:
    def then(rec: Any, call: int) -> None:
        rec[signals.TAU_CMD, 3] = -np.inf

    _law(then)


def law_too_much() -> None:
    def then(rec: Any, call: int) -> None:
        rec[signals.TAU_CMD, 3] = 1e6

    _law(then)


def law_raises() -> None:
    def then(rec: Any, call: int) -> None:
        raise ZeroDivisionError("in a law of one's own")

    _law(then)


def law_slow() -> None:
    def then(rec: Any, call: int) -> None:
        until = time.monotonic() + 0.005
        while time.monotonic() < until:
            pass

    _law(then)


def hog_in_the_process() -> None:
    """A thread that never gives the interpreter up of its own accord."""

    def then(rec: Any, call: int) -> None:
        if call == AT_CALL:
            threading.Thread(target=spin, daemon=True).start()

    def spin() -> None:
        while True:
            pass

    _law(then)


def bus_lost() -> None:
    """The second of three buses goes away."""
    latch, steps = Rig._latch, [0]

    def broken(self: Any) -> None:
        steps[0] += 1
        if steps[0] == AT_STEP:
            for client in self.ports[1]._clients:
                client.socket.close()
            self.ports[1]._clients.clear()
            self.ports[1].fds_version += 1
        latch(self)

    Rig._latch = broken  # type: ignore[method-assign]


def disk_full() -> None:
    """The recorder can write so much and no more."""
    record = roles.recorder

    def limited(*args: Any, **kwargs: Any) -> dict[str, Any]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (LOG_BYTES, LOG_BYTES))
        return record(*args, **kwargs)

    roles.recorder = limited


def clock_jumps() -> None:
    """The clock on the wall goes an hour back, and two on, every tenth of a second."""
    now, now_ns = time.time, time.time_ns

    def jump() -> float:
        return (0.0, -JUMP_S, 2.0 * JUMP_S)[int(time.monotonic() * 10) % 3]

    time.time = lambda: now() + jump()
    time.time_ns = lambda: now_ns() + int(jump() * 1e9)


def short_patience() -> None:
    """The launcher waits a second for a child to end, not five."""
    launcher._END_PATIENCE_S = 1.0
