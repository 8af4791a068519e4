"""Child processes: forked with everything imported, named, and reporting how they ended.

Forking before any thread exists lets the children share the imports (a second or two
each), the shared memory and the listening sockets. Children ignore SIGINT, which a
terminal sends to all of them; the launcher decides. When the launcher dies, the kernel
sends them SIGTERM.
"""

from __future__ import annotations

import mmap
import os
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec
import numpy as np

from dftc_rt.errors import DftcError
from dftc_rt.rt.process import die_with_parent, name_process

_REPORT_LIMIT = 1 << 20


class Flags:
    """A page that all processes of a run share.

    Attributes:
        stop: The controller is to stop safely.
        end: The rig is to end.
        running: The controller's loop runs.
        serving: The rig has been built and answers.
    """

    def __init__(self) -> None:
        """Map the page; it is inherited by fork and goes with the last process."""
        self._map = mmap.mmap(-1, mmap.PAGESIZE)
        self._words = np.frombuffer(self._map, dtype=np.int64)

    def _get(self, index: int) -> bool:
        return bool(self._words[index])

    @property
    def stop(self) -> bool:
        """The controller is to stop safely."""
        return self._get(0)

    @stop.setter
    def stop(self, value: bool) -> None:
        self._words[0] = value

    @property
    def end(self) -> bool:
        """The rig is to end."""
        return self._get(1)

    @end.setter
    def end(self, value: bool) -> None:
        self._words[1] = value

    @property
    def running(self) -> bool:
        """The controller's loop runs."""
        return self._get(2)

    @running.setter
    def running(self, value: bool) -> None:
        self._words[2] = value

    @property
    def serving(self) -> bool:
        """The rig has been built and answers."""
        return self._get(3)

    @serving.setter
    def serving(self, value: bool) -> None:
        self._words[3] = value


class Child:
    """One child process.

    Attributes:
        name: As the system's tables show it.
        pid: Process id.
        code: Exit code once it has ended (128 + signal when killed), else None.
        report: What it returned once it has ended; {"error": line} when it failed.
    """

    def __init__(self, name: str, function: Callable[[], dict[str, Any]]) -> None:
        """Fork a child that runs ``function`` and reports what it returns.

        Args:
            name: At most 15 characters.
            function: Runs in the child; its result must be JSON-ready.
        """
        self.name = name
        self.code: int | None = None
        self.report: dict[str, Any] = {}
        self._pipe, write = os.pipe2(os.O_CLOEXEC)
        sys.stdout.flush()
        sys.stderr.flush()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(self._pipe)
            os._exit(_run(name, function, write))
        os.close(write)

    def poll(self) -> int | None:
        """Return the exit code, or None while it runs."""
        if self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._ended(status)
        return self.code

    @property
    def stopped(self) -> bool:
        """Whether somebody has stopped it (SIGSTOP)."""
        try:
            stat = Path(f"/proc/{self.pid}/stat").read_text()
        except OSError:
            return False  # it has ended
        return stat.rpartition(")")[2].split()[0] == "T"

    def kill(self) -> None:
        """End it at once, and wait until it has gone."""
        if self.code is None:
            os.kill(self.pid, signal.SIGKILL)
            _, status = os.waitpid(self.pid, 0)
            self._ended(status)

    def terminate(self) -> None:
        """Ask it to end."""
        if self.code is None:
            os.kill(self.pid, signal.SIGTERM)

    def _ended(self, status: int) -> None:
        if os.WIFSIGNALED(status):
            self.code = 128 + os.WTERMSIG(status)
        else:
            self.code = os.WEXITSTATUS(status)
        with os.fdopen(self._pipe, "rb") as pipe:
            raw = pipe.read(_REPORT_LIMIT)
        if raw:
            self.report = msgspec.json.decode(raw)
        elif os.WIFSIGNALED(status):
            name = signal.Signals(os.WTERMSIG(status)).name
            self.report = {"error": f"{self.name} was killed ({name})"}
        else:
            self.report = {"error": f"{self.name} ended with code {self.code} and said nothing"}


def on_sigterm(action: Callable[[], None]) -> None:
    """Have ``action`` run in this process when it is asked to end."""

    def handler(number: int, frame: FrameType | None) -> None:
        action()

    signal.signal(signal.SIGTERM, handler)


def _run(name: str, function: Callable[[], dict[str, Any]], write: int) -> int:
    """Child side: run, report, and return the exit code; never raises."""
    parent = os.getppid()
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):  # the launcher decides
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    name_process(name)
    die_with_parent(signal.SIGTERM)
    code = 0
    try:
        if os.getppid() != parent:  # it died before we asked to be told
            return 1
        report = function()
    except DftcError as error:
        report, code = {"error": str(error), "exit_code": error.exit_code}, error.exit_code
    except BaseException as error:
        traceback.print_exc()
        report, code = {"error": f"{name}: {type(error).__name__}: {error}", "exit_code": 1}, 1
    try:
        sys.stdout.flush()
        sys.stderr.flush()
        with os.fdopen(write, "wb") as pipe:
            pipe.write(msgspec.json.encode(report))
    except OSError:
        code = code or 1  # the launcher has gone; there is nobody left to tell
    return code
