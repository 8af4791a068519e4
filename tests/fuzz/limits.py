"""What a reader of bad input may take of the machine, and what it may say."""

from __future__ import annotations

import contextlib
import resource
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

from dftc_rt.errors import DftcError

MOST_BYTES = 3 << 30  # of address space, on top of what the process has
MOST_S = 300  # by far, and with kernels to compile: what takes so long hangs
LONGEST_LINE = 1000


class HangsError(BaseException):
    """It took too long. No ``Exception``: nothing on the way may take it for an answer."""


@contextlib.contextmanager
def bounded() -> Iterator[None]:
    """Let what is inside have so much time and memory, and no more.

    Raises:
        HangsError: It took too long.
        MemoryError: It asked for too much.
    """

    def give_up(number: int, frame: FrameType | None) -> None:
        raise HangsError(f"no end after {MOST_S} s")

    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    alarmed = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGALRM, give_up) if alarmed else None
    signal.alarm(MOST_S if alarmed else 0)
    try:
        yield
    finally:
        signal.alarm(0)
        if alarmed:
            signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)


def one_line(error: DftcError) -> None:
    """Assert that an error is one line that a person can read."""
    text = str(error)
    assert text.isprintable(), f"not printable: {text[:500]!r}"
    assert len(text) <= LONGEST_LINE, f"{len(text)} characters: {text[:200]}"
