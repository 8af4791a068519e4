"""SIGINT, SIGTERM and SIGHUP, from a command's first line to its last: nothing is left behind.

While everything is imported, there is nothing to clean up, and the command leaves at once.
After that the first of them is an exception, and those that follow at once are not heard:
whatever has been made is removed by whoever made it, and a second Ctrl-C must not cut that
short. A command that has something to bring to rest takes them over with
:func:`stop_requests`.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Final

STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What asks a run to stop safely: Ctrl-C, a polite kill, a terminal that closes."""

EXIT_CODE: Final = 130

_DEFAULTS: Final = (signal.SIG_DFL, signal.default_int_handler)
_CLEAN_UP_S: Final = 2.0
_raised_at = -_CLEAN_UP_S  # s, of the monotonic clock


def leave_at_once() -> None:
    """Have each signal that is not ignored end this process: nothing has been started yet."""
    _replace(_DEFAULTS, _leave)


def interrupt_once() -> None:
    """Have a signal raise ``KeyboardInterrupt``, where :func:`leave_at_once` was before.

    Not those of the next two seconds; one after that does again, should something that called
    back into Python have swallowed the first.
    """
    _replace((_leave,), _interrupt)


@contextlib.contextmanager
def stop_requests(action: Callable[[], None]) -> Iterator[None]:
    """Have ``action`` called at each signal meanwhile; the handlers before come back at the end.

    SIGHUP stays ignored where it is: a command under nohup outlives its terminal.
    """

    def handler(number: int, frame: FrameType | None) -> None:
        action()

    before = {
        number: signal.signal(number, handler)
        for number in STOP_SIGNALS
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, each in before.items():
            signal.signal(number, each)


def _replace(old: tuple[object, ...], new: Callable[[int, FrameType | None], None]) -> None:
    for number in STOP_SIGNALS:
        if signal.getsignal(number) in old:
            signal.signal(number, new)


def _leave(number: int, frame: FrameType | None) -> None:
    # An exception may be swallowed or reported by whatever is being imported.
    print("dftc: interrupted", file=sys.stderr, flush=True)
    os._exit(EXIT_CODE)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _raised_at
    now = time.monotonic()
    if now - _raised_at >= _CLEAN_UP_S:
        _raised_at = now
        raise KeyboardInterrupt
