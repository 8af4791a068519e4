"""Standard output and error as a command may find them: closed, full, with nobody reading.

A result that cannot be printed is an error of the command. A diagnostic that cannot be
printed is none: a robot does not stop because a terminal has gone.
"""

from __future__ import annotations

import io
import os
import sys
from typing import BinaryIO, ClassVar, cast

from dftc_rt.errors import DftcError

_BROKEN_PIPE = 141  # 128 + SIGPIPE, as a shell reports a program that the signal ended


class OutputError(DftcError, OSError):
    """Standard output cannot be written; ``quiet`` when its reader has simply gone."""

    exit_code: ClassVar[int] = 1

    def __init__(self, error: OSError) -> None:
        self.quiet = isinstance(error, BrokenPipeError)
        self.reason = error.strerror or str(error)
        super().__init__(error.errno, self.reason)

    def __str__(self) -> str:
        return f"standard output: cannot be written: {self.reason}"


class _Output(io.TextIOWrapper):
    """Standard output that raises :class:`OutputError`."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError as error:
            raise OutputError(error) from None

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            raise OutputError(error) from None


class _Diagnostics(io.TextIOWrapper):
    """Standard error that falls silent when it cannot be written any more."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError:
            discard(2)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError:
            discard(2)


def guard() -> None:
    """Take charge of the standard streams of this process; to be called before all else."""
    # Where one is closed, the next file to be opened would take its place, be it a log.
    for descriptor, flags in ((0, os.O_RDONLY), (1, os.O_RDONLY), (2, os.O_WRONLY)):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, flags)  # gets the lowest number that is free: this one
    sys.stdout = _Output(*_detached(sys.stdout, 1), line_buffering=os.isatty(1))
    sys.stderr = _Diagnostics(*_detached(sys.stderr, 2), line_buffering=True)


def discard(descriptor: int) -> None:
    """Let what is still to be written there go nowhere."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, descriptor)
    os.close(null)


def answer(error: OutputError) -> int:
    """Say that the results are lost; return the exit code."""
    discard(1)
    if error.quiet:
        return _BROKEN_PIPE
    print(f"dftc: {error}", file=sys.stderr)
    return error.exit_code


def _detached(stream: object, descriptor: int) -> tuple[BinaryIO, str, str]:
    """Buffer, encoding and error handling of a stream that nobody may use any more.

    A terminal that knows no Greek gets question marks rather than no summary.
    """
    if isinstance(stream, io.TextIOWrapper):
        encoding, errors = stream.encoding, stream.errors
        errors = "replace" if errors in (None, "strict") else errors
        return cast("BinaryIO", stream.detach()), encoding, errors
    raw = open(descriptor, "wb", closefd=False)  # noqa: SIM115 - as long as the process
    return raw, "utf-8", "replace"
