"""The files that a command will write: refused before anything has started.

A run that finds out at its end that its log went nowhere has been for nothing, and a log
that replaces an earlier one has lost that.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from dftc_rt.cli.session import Session
from dftc_rt.errors import EnvironmentLacksError, InputError, LogError
from dftc_rt.log.chunks import MAGIC

DEFAULT_FOLDER: Final = Path("logs")
_NAME_BYTES: Final = 200  # of a run's name in a file's: at most 255 with time and ending


@contextmanager
def log_file(opened: Session, log: str | Path | None, *, report: bool = False) -> Iterator[Path]:
    """Where to log, checked; with ``report``, the report's place beside it too.

    Without a name given, the file is made at once, so that no other run takes the name.
    What has been made and not been used is removed again at the end.

    Args:
        opened: The session.
        log: As the user named it; None for logs/SCENARIO-TIME.mcap, never one that exists.
        report: Whether a report is written beside the log.

    Raises:
        InputError: It is no file that can be written, or holds something else than a log.
        EnvironmentLacksError: The disk is full.
    """
    folder = DEFAULT_FOLDER if log is None else Path(log).parent
    made = _make_folders(folder)
    claimed: Path | None = None
    try:
        if log is None:
            path = claimed = _claim(folder, opened.scenario.name)
        else:
            path = Path(log)
            _check_log(log)
        if report:
            check_output(path.with_suffix(".html"))
        yield path
    finally:
        if claimed is not None and claimed.exists() and not claimed.stat().st_size:
            claimed.unlink()
        with contextlib.suppress(OSError):  # there is something in it: it has been used
            for each in reversed(made):
                each.rmdir()


def check_output(path: str | Path) -> None:
    """Refuse what cannot be written as a plain file; a file that is there stays as it is.

    Raises:
        InputError: A folder, a device or the like, or it cannot be opened for writing.
        EnvironmentLacksError: The disk is full.
    """
    where = _shown(path)
    if not os.fspath(path):
        raise InputError("an output file", "''", "a file to write")
    target = os.path.realpath(path)
    try:
        new = not os.path.lexists(target)
        if not new:
            mode = os.stat(target).st_mode
            if stat.S_ISDIR(mode):
                raise InputError(where, "is a folder", "a file to write")
            if not stat.S_ISREG(mode):  # as root, a device would be written to
                raise InputError(where, "is no plain file", "a file to write")
        flags = os.O_WRONLY | os.O_CLOEXEC | (os.O_CREAT | os.O_EXCL if new else 0)
        descriptor = os.open(target, flags, 0o666)
        try:
            if new:
                os.write(descriptor, b"\0")  # a full disk lets files be made, and nothing in them
        finally:
            os.close(descriptor)
            if new:
                os.unlink(target)
    except OSError as error:
        if isinstance(error, InputError):
            raise
        raise _explained(where, error) from None


def _check_log(log: str | Path) -> None:
    check_output(log)
    path = Path(log)
    if path.suffix == ".html":  # there the report goes
        raise InputError(_shown(path), "is no name for a log", "another ending, such as .mcap")
    if path.exists():
        with path.open("rb") as stream:
            start = stream.read(len(MAGIC))
        if start and start != MAGIC:
            raise LogError(_shown(path), "holds something else", "a new file, or a log to replace")


def _make_folders(folder: Path) -> list[Path]:
    """Make a folder and those above it; return which were made, the uppermost first."""
    missing = [each for each in (folder, *folder.parents) if not os.path.lexists(each)][::-1]
    made: list[Path] = []
    try:
        for each in missing:
            with contextlib.suppress(FileExistsError):  # another run was faster
                each.mkdir()
                made.append(each)
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
    except OSError as error:
        with contextlib.suppress(OSError):
            for each in reversed(made):
                each.rmdir()
        raise _explained(_shown(folder), error, "a folder to log into") from None
    return made


def _claim(folder: Path, name: str) -> Path:
    """Make a new file named for the run and the time; a second within one gets a number."""
    short = os.fsencode(name)[:_NAME_BYTES].decode(errors="ignore")
    stem = f"{short}-{time.strftime('%Y%m%d-%H%M%S')}"
    path, number = folder / f"{stem}.mcap", 1
    while not _made(path):
        number += 1
        path = folder / f"{stem}-{number}.mcap"
    return path


def _made(path: Path) -> bool:
    """Whether an empty file could be made there, with no report of another log beside it."""
    if os.path.lexists(path.with_suffix(".html")):
        return False
    try:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666))
    except FileExistsError:
        return False
    except OSError as error:
        raise _explained(_shown(path), error) from None
    return True


def _explained(
    where: str, error: OSError, expected: str = "a file to write"
) -> InputError | EnvironmentLacksError:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return EnvironmentLacksError(
            f"no space left to write {where}", "free some, or log elsewhere"
        )
    return InputError(where, f"cannot be written: {error.strerror}", expected)


def _shown(path: str | Path) -> str:
    text = os.fspath(path)
    return text if len(text) <= 80 else f"{text[:40]}...{text[-37:]}"
