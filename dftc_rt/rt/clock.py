"""Clocks of the executor: absolute deadlines in real time, none in lock-step, a fake for tests."""

from __future__ import annotations

import ctypes
import errno
import os
import time
from typing import Protocol

NS = 1_000_000_000


class Clock(Protocol):
    """Time as the executor sees it, in nanoseconds."""

    lockstep: bool

    def now(self) -> int:
        """Return the time, ns. Real-time safe."""
        ...

    def sleep_until(self, deadline: int) -> None:
        """Block until ``deadline``, ns; return at once when it has passed."""
        ...


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


class RealClock:
    """CLOCK_MONOTONIC with absolute sleeps, so lateness does not pile up."""

    lockstep = False

    def __init__(self) -> None:
        self._nanosleep = ctypes.CDLL(None).clock_nanosleep
        self._request = _Timespec()
        self._pointer = ctypes.byref(self._request)

    def now(self) -> int:
        """Return CLOCK_MONOTONIC, ns."""
        return time.monotonic_ns()

    def sleep_until(self, deadline: int) -> None:
        """Sleep until ``deadline`` on CLOCK_MONOTONIC, ns.

        Raises:
            OSError: The kernel refused the sleep.
        """
        self._request.tv_sec, self._request.tv_nsec = divmod(deadline, NS)
        while True:
            status = self._nanosleep(1, 1, self._pointer, None)  # CLOCK_MONOTONIC, TIMER_ABSTIME
            if status == 0:
                return
            if status != errno.EINTR:
                raise OSError(status, os.strerror(status))


class LockstepClock:
    """Never waits: the barrier on the bus paces the run. Time still passes for measurements."""

    lockstep = True

    def now(self) -> int:
        """Return CLOCK_MONOTONIC, ns."""
        return time.monotonic_ns()

    def sleep_until(self, deadline: int) -> None:
        """Return at once."""


class FakeClock:
    """Time under a test's control: a sleep ends late by what the test says.

    Attributes:
        time: The time, ns.
        delays: Extra lateness of each coming sleep, ns, consumed front to back.
    """

    lockstep = False

    def __init__(self) -> None:
        self.time = 0
        self.delays: list[int] = []

    def now(self) -> int:
        """Return the fake time, ns."""
        return self.time

    def sleep_until(self, deadline: int) -> None:
        """Advance to ``deadline`` (never backwards), plus the next delay."""
        self.time = max(self.time, deadline)
        if self.delays:
            self.time += self.delays.pop(0)
