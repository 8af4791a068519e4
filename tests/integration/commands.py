"""What the integration tests share: commands as processes, logs as bytes, waiting."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray

DFTC = str(Path(sys.executable).with_name("dftc"))
DEADLINE_S = 60.0  # far more than anything here takes: a test that waits this long has failed
# Other programs hold up real-time runs on a shared host: nothing is proven by stopping for it.
WATCHDOG_S = 0.25
PATIENT = (
    "--set", f"rig.drive.watchdog_s={WATCHDOG_S}", "--set", "supervisor.stale_cycles=250",
)  # fmt: skip
STALL_S = 0.02
ATTEMPTS = 4  # of a real-time run that the host may hold up
WALL_FIELDS = (1, 2, 3)  # lateness, compute, exchange in the header of /cycle


def dftc(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        [DFTC, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=DEADLINE_S
    )


def until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition.

    Raises:
        TimeoutError: It did not come about.
    """
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(what)
        time.sleep(0.01)


@dataclass
class Started:
    """A command that runs.

    Attributes:
        process: The process.
        folder: Its working folder; TMPDIR too, so that whatever it leaves is found there.
    """

    process: subprocess.Popen[bytes]
    folder: Path

    @property
    def err(self) -> str:
        """What it has said on stderr so far."""
        return (self.folder / "stderr").read_text()

    @property
    def out(self) -> str:
        """What it has said on stdout so far."""
        return (self.folder / "stdout").read_text()

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for a condition while it runs."""
        until(lambda: condition() or self.process.poll() is not None, what)
        assert condition(), f"ended before {what}: {self.err}"

    def until_said(self, text: str) -> None:
        """Wait until it says something on stderr."""
        self.until(lambda: text in self.err, f"stderr: {text}")

    def until_running(self) -> None:
        """Wait for the first line of status: the loop runs."""
        self.until_said("worst error")

    def end(self) -> int:
        """Wait for its end; return the exit code."""
        return self.process.wait(DEADLINE_S)

    def children(self) -> dict[str, int]:
        """Return name -> pid of its children."""
        return children(self.process.pid)


@contextmanager
def started(folder: Path, *command: str | Path) -> Iterator[Started]:
    """Start a command; it and its children are gone at the end, whatever happens."""
    folder.mkdir(exist_ok=True)
    environment = os.environ | {"TMPDIR": str(folder)}
    with (folder / "stdout").open("wb") as out, (folder / "stderr").open("wb") as err:
        process = subprocess.Popen(
            [*map(str, command)], cwd=folder, env=environment, stdout=out, stderr=err
        )
    run = Started(process, folder)
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


def children(parent: int) -> dict[str, int]:
    """Return name -> pid of the living children of a process."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = stat.read_text()
        except OSError:
            continue  # it has just ended
        name, rest = text.split("(", 1)[1].rsplit(")", 1)
        state, ppid = rest.split()[:2]
        if int(ppid) == parent and state != "Z":
            found[name] = int(stat.parent.name)
    return found


def gone(pid: int) -> bool:
    """Return whether a process has ended, reaped or not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def payloads(log: Path, topic: str) -> list[bytes]:
    """Return the messages of a topic, as they lie in the log."""
    with log.open("rb") as stream:
        return [m.data for _, _, m in make_reader(stream).iter_messages(topics=[topic])]


def topics(log: Path) -> set[str]:
    """Return the topics that have a message."""
    with log.open("rb") as stream:
        return {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}


def stalled(log: Path) -> bool:
    """Return whether the host held the controller up for longer than a real one may be."""
    lateness = [np.frombuffer(p[4:], "<f8", 2)[1] for p in payloads(log, "/cycle")]
    return bool(lateness) and max(lateness) > STALL_S


def attachments(log: Path) -> dict[str, bytes]:
    """Return the attachments by name."""
    with log.open("rb") as stream:
        return {a.name: a.data for a in make_reader(stream).iter_attachments()}


def repeatable(log: Path) -> tuple[bytes, bytes]:
    """Return all bytes of /cycle, wall-time fields blanked, and all of /rig."""
    cycle = np.array(
        [np.frombuffer(p[4:], np.uint64) for p in payloads(log, "/cycle")], dtype=np.uint64
    )
    cycle[:, WALL_FIELDS] = 0
    return cycle.tobytes(), b"".join(payloads(log, "/rig"))


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))
