"""The test's side of :mod:`tests.integration.fork_server`: commands that start at once."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.integration.commands import Started

ROOT = Path(__file__).parents[2]
WARM_UP_S = 900.0  # kernels may have to be compiled
PATIENCE_S = 60.0


@dataclass
class Forked:
    """A process as ``subprocess.Popen`` shows one; the fork server is its parent."""

    pid: int
    server: ForkServer

    def poll(self) -> int | None:
        """Return the exit code, or None while it runs."""
        self.server.read(0.0)
        return self.server.ended.get(self.pid)

    def wait(self, timeout: float = PATIENCE_S) -> int:
        """Wait for its end; return the exit code."""
        deadline = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > deadline:
                raise TimeoutError(f"process {self.pid} has not ended")
            time.sleep(0.01)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


class ForkServer:
    """Starts commands.

    Attributes:
        ended: Exit code of each process that has ended, by pid.
    """

    def __init__(self, scenario: str, settings: Sequence[str]) -> None:
        """Start it and wait until it has warmed up."""
        self.ended: dict[int, int] = {}
        self._lines: list[str] = []
        self._buffer = b""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.integration.fork_server", scenario, *settings],
            cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        try:
            assert self._take(WARM_UP_S) == "ready"
        except BaseException:
            self._process.kill()
            self.close()
            raise

    def read(self, timeout_s: float) -> None:
        """Take in what it says."""
        assert self._process.stdout is not None
        stream = self._process.stdout.fileno()
        if not select.select([stream], [], [], timeout_s)[0]:
            return
        data = os.read(stream, 65536)
        assert data, "the fork server has ended"
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in lines:
            what, _, rest = line.decode().partition(" ")
            if what == "ended":
                pid, code = rest.split()
                self.ended[int(pid)] = int(code)
            else:
                self._lines.append(line.decode())

    def _take(self, timeout_s: float) -> str:
        deadline = time.monotonic() + timeout_s
        while not self._lines:
            if time.monotonic() > deadline:
                raise TimeoutError("the fork server says nothing")
            self.read(0.1)
        return self._lines.pop(0)

    @contextmanager
    def start(
        self, folder: Path, arguments: Sequence[str | Path], breaks: Sequence[str] = ()
    ) -> Iterator[Started]:
        """Start a command; it and its children are gone at the end, whatever happens."""
        folder.mkdir(exist_ok=True)
        for name in ("stdout", "stderr"):
            (folder / name).touch()
        order = {
            "folder": str(folder), "arguments": [str(a) for a in arguments], "breaks": list(breaks),
        }  # fmt: skip
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order).encode() + b"\n")
        self._process.stdin.flush()
        process = Forked(int(self._take(PATIENCE_S).removeprefix("started ")), self)
        run = Started(process, folder)  # type: ignore[arg-type]
        try:
            yield run
        finally:
            left = list(run.children().values())
            if process.poll() is None:
                process.kill()
                process.wait()
            for pid in left:
                if Path(f"/proc/{pid}").exists():
                    os.kill(pid, signal.SIGKILL)

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        self._process.wait(PATIENCE_S)
        self._process.stdout.close()
