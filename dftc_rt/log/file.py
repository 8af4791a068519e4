"""The file under the MCAP writer, which tells of errors that the writer only prints.

foxglove-sdk reports a failed write as a warning and goes on; a recorder must stop.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

from dftc_rt.errors import EnvironmentLacksError, LogError


class LogFile:
    """Unbuffered file that keeps the first error for :meth:`check`."""

    def __init__(self, path: Path, mode: str) -> None:
        """Open ``path`` with mode ``wb`` or ``xb``.

        Raises:
            LogError: It cannot be opened.
            EnvironmentLacksError: The disk is full.
        """
        self._path = path
        self._error: OSError | None = None
        try:
            self._raw = open(path, mode, buffering=0)  # noqa: SIM115 - closed by the recorder
        except OSError as error:
            raise self._explain(error) from None

    @property
    def closed(self) -> bool:
        """Whether :meth:`close` was called."""
        return bool(self._raw.closed)

    def write(self, data: bytes) -> int:
        """Write all of ``data``; after an error, nothing any more."""
        rest = memoryview(data)
        try:
            while rest and self._error is None:
                rest = rest[os.write(self._raw.fileno(), rest) :]
        except OSError as error:
            self._error = error
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Move; the writer only asks where it is."""
        return int(self._raw.seek(offset, whence))

    def flush(self) -> None:
        """Nothing is buffered here."""

    def close(self) -> None:
        """Close the descriptor."""
        self._raw.close()

    def check(self) -> None:
        """Raise what :meth:`write` met.

        Raises:
            LogError: The file cannot be written.
            EnvironmentLacksError: The disk is full.
        """
        if self._error is not None:
            raise self._explain(self._error) from None

    def _explain(self, error: OSError) -> LogError | EnvironmentLacksError:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            return EnvironmentLacksError(
                f"no space left to write {self._path}",
                "free some, or log elsewhere; what is written so far: dftc recover",
            )
        return LogError(str(self._path), f"cannot be written: {error.strerror}")
