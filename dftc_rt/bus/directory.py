"""Where the user-space buses live: one directory, one socket a bus, one owner."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from dftc_rt.errors import EnvironmentLacksError, InputError

_BUS_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_SUN_PATH: Final = 108  # bytes of sockaddr_un.sun_path, the closing zero included
_OWNER_FILE: Final = "owner.pid"


def resolve_directory(
    bus_dir: str | os.PathLike[str] | None = None, environ: Mapping[str, str] = os.environ
) -> Path:
    """Return the directory of the buses: option, ``$DFTC_BUS_DIR``, XDG, ``/tmp/dftc-<uid>``.

    Args:
        bus_dir: The ``--bus-dir`` option; None or "" when it was not given.
        environ: Environment to look in.
    """
    chosen = os.fspath(bus_dir) if bus_dir else environ.get("DFTC_BUS_DIR")
    if chosen:
        return Path(chosen)
    runtime = environ.get("XDG_RUNTIME_DIR")
    return Path(runtime, "dftc") if runtime else Path(f"/tmp/dftc-{os.geteuid()}")


def socket_path(directory: Path, name: str) -> Path:
    """Return the path of the bus ``name``.

    Raises:
        InputError: The name is no bus name, or the path does not fit a socket address.
    """
    if not _BUS_NAME.fullmatch(name) or name == _OWNER_FILE:
        raise InputError("bus name", repr(name), "letters, digits, '_', '.', '-'")
    path = directory / name
    if len(os.fsencode(path)) >= _SUN_PATH:
        raise InputError(
            str(path), "the path is too long for a socket", f"fewer than {_SUN_PATH} bytes"
        )
    return path


def check_directory(directory: Path) -> None:
    """Refuse a directory that anyone else could have put sockets into.

    Raises:
        InputError: It is missing, no directory, somebody else's, or open to others.
    """
    try:
        status = directory.lstat()
    except OSError as error:
        raise InputError(str(directory), error.strerror or "unreadable", "a directory") from error
    if not stat.S_ISDIR(status.st_mode):
        raise InputError(str(directory), "not a directory", "a directory of mode 0700")
    if status.st_uid != os.geteuid():
        raise InputError(
            str(directory), f"belongs to uid {status.st_uid}", f"uid {os.geteuid()} to own it"
        )
    mode = stat.S_IMODE(status.st_mode)
    if mode != 0o700:
        raise InputError(str(directory), f"mode {mode:04o}", "mode 0700")


class BusDirectory:
    """The claim of one process on a directory of buses, until it is released or dies.

    Attributes:
        path: The directory.
    """

    def __init__(self, path: Path) -> None:
        """Create the directory if need be, claim it and remove what a dead owner left.

        Raises:
            InputError: The directory is unsafe, or a living process has claimed it.
            EnvironmentLacksError: It cannot be created.
        """
        self.path = path
        try:
            path.mkdir(mode=0o700, exist_ok=True)
        except FileExistsError:
            pass  # something else has the name: check_directory says what
        except FileNotFoundError as error:
            raise InputError(str(path), "its parent directory does not exist") from error
        except OSError as error:
            raise EnvironmentLacksError(
                f"{path}: {error.strerror}", "name a writable directory with --bus-dir"
            ) from error
        check_directory(path)
        self._lock = _claim(path)
        _remove_sockets(path)

    def release(self) -> None:
        """Remove the sockets and the claim; a second call does nothing.

        Somebody may have removed the directory meanwhile, and another have made it anew: what
        lies there then is not ours.
        """
        if self._lock < 0:
            return
        owner = self.path / _OWNER_FILE
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            if os.path.samestat(owner.lstat(), os.fstat(self._lock)):
                _remove_sockets(self.path)
                owner.unlink(missing_ok=True)
        os.close(self._lock)
        self._lock = -1


def _remove_sockets(path: Path) -> None:
    for entry in path.iterdir():
        with contextlib.suppress(FileNotFoundError):
            if stat.S_ISSOCK(entry.lstat().st_mode):
                entry.unlink()


def _claim(path: Path) -> int:
    """Lock the owner file and write our pid into it; return its descriptor.

    The lock, not the pid, is the claim: it ends with its process, even a killed one.
    """
    owner = path / _OWNER_FILE
    while True:
        try:
            lock = os.open(owner, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            raise InputError(str(owner), error.strerror or "unusable", "a plain file") from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            pid = os.pread(lock, 32, 0).decode("ascii", "replace").strip()
            os.close(lock)
            raise InputError(
                str(path), f"in use by process {pid or 'unknown'}", "a directory of its own"
            ) from error
        with contextlib.suppress(FileNotFoundError):
            if os.stat(owner).st_ino == os.fstat(lock).st_ino:
                os.ftruncate(lock, 0)
                os.pwrite(lock, f"{os.getpid()}\n".encode(), 0)
                return lock
        os.close(lock)  # its owner removed the file while we were opening it: once more
