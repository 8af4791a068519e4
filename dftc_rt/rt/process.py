"""Turn a process into a real-time one, step by step, reporting each refused step once.

Order matters: imports and JIT warm-up come first (by the caller), because locking
memory before the imports fails under a finite RLIMIT_MEMLOCK, and because objects
frozen by :func:`gc.freeze` are never looked at again.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import struct
import sys

_PR_SET_PDEATHSIG = 1
_PR_SET_NAME = 15
_PR_SET_TIMERSLACK = 29
_MCL_CURRENT_FUTURE = 3


def name_process(name: str) -> None:
    """Set the name under which the system's tables show this process (15 characters)."""
    ctypes.CDLL(None).prctl(_PR_SET_NAME, name.encode()[:15], 0, 0, 0)


def die_with_parent(signal_number: int) -> None:
    """Have the kernel send ``signal_number`` to this process when its parent dies."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal_number, 0, 0, 0)


class RealTime:
    """Real-time settings of this process, held until :meth:`release`.

    Attributes:
        refused: One line for each step that the system refused, with the remedy.
    """

    def __init__(self, priority: int, core: int | None) -> None:
        """Freeze the garbage collector, lock memory, pin and raise this process.

        Args:
            priority: SCHED_FIFO priority, 1..99.
            core: Core to run on, or None to leave the affinity alone.
        """
        self.refused: list[str] = []
        self._latency_fd = -1
        gc.collect()
        gc.freeze()
        gc.disable()
        self._lock_memory()
        if core is not None:
            self._pin(core)
        self._raise_priority(priority)
        # Where SCHED_FIFO was refused, the kernel would round every wake-up by 50 µs.
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
        self._hold_latency()

    def release(self) -> None:
        """Give back what outlasts a process's own end only by accident."""
        if self._latency_fd >= 0:
            os.close(self._latency_fd)
            self._latency_fd = -1
        gc.enable()
        gc.unfreeze()

    def _lock_memory(self) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(_MCL_CURRENT_FUTURE) != 0:
            reason = os.strerror(ctypes.get_errno())
            self.refused.append(
                f"memory not locked ({reason}): raise 'memlock' in /etc/security/limits.conf"
            )

    def _pin(self, core: int) -> None:
        try:
            os.sched_setaffinity(0, {core})
        except OSError as error:
            self.refused.append(f"not pinned to core {core} ({error.strerror})")

    def _raise_priority(self, priority: int) -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except OSError as error:
            self.refused.append(
                f"no SCHED_FIFO ({error.strerror}): allow 'rtprio' in "
                "/etc/security/limits.conf, or run as root"
            )

    def _hold_latency(self) -> None:
        try:
            self._latency_fd = os.open("/dev/cpu_dma_latency", os.O_WRONLY | os.O_CLOEXEC)
            os.write(self._latency_fd, struct.pack("i", 0))
        except OSError as error:
            if self._latency_fd >= 0:
                with contextlib.suppress(OSError):
                    os.close(self._latency_fd)
                self._latency_fd = -1
            self.refused.append(
                f"processor sleep states stay on ({error.strerror}): "
                "give the user write access to /dev/cpu_dma_latency"
            )


def last_core() -> int:
    """Return the highest core this process may run on (core 0 serves most interrupts)."""
    return max(os.sched_getaffinity(0))


def first_core() -> int:
    """Return the lowest core this process may run on; the last one where there is no other."""
    return min(os.sched_getaffinity(0))


def stand_back() -> None:
    """Keep this process out of the way of the loop: low priority, and not on the last core."""
    os.nice(10)
    cores = os.sched_getaffinity(0)
    if len(cores) > 1:
        os.sched_setaffinity(0, cores - {last_core()})


def report_refused(who: str, refused: list[str]) -> None:
    """Print each refused step as one line on standard error."""
    for line in refused:
        print(f"{who}: {line}", file=sys.stderr, flush=True)
