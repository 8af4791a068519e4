"""A run of ``dftc hil`` in real time, something that happens to it, and what is left of it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import LogError
from dftc_rt.log.pieces import read_pieces
from dftc_rt.log.reader import is_torn, read_piece
from dftc_rt.log.recover import recover
from dftc_rt.log.run import Run
from tests.integration.commands import PATIENT, Started, gone, until
from tests.integration.forked import ForkServer

SCENARIO = "panda_shoulder_loss"
PERIOD_S = 0.001
CYCLES = 20  # within which the arm is safe, where the controller lives
LOST_S = 0.3  # of a log, at most
EMPTY_BYTES = 100  # of a log that has nothing to tell, at most
RUN, DEGRADED, SAFE_STOP, FAULT, FINISH = 3, 4, 5, 6, 7
NAMES = {"dftc-controller", "dftc-rig", "dftc-recorder"}
F64 = NDArray[np.float64]


@dataclass
class Survived:
    """A run that has ended.

    Attributes:
        code, err: Exit code and standard error.
        log: The run as its files have it, recovered where they were torn.
    """

    code: int
    err: str
    log: Run

    @property
    def rig(self) -> dict[str, F64]:
        assert self.log.rig is not None
        return self.log.rig

    def last_following_s(self) -> float:
        """When the arm last followed its reference: the cycle in which something was found."""
        following = np.isin(self.log.cycle["state"], (RUN, DEGRADED))
        return float(self.log.cycle["t"][following][-1])

    def last_command_s(self) -> float:
        """Rig time of the last row before which a command had come to the first joint.

        Without one, the age of the command grows from row to row.
        """
        came = np.flatnonzero(np.diff(self.rig["cmd_age"][:, 0]) <= 0.0) + 1
        return float(self.rig["t"][came[-1]])

    def said_its_end(self) -> bool:
        """Whether the controller's last word is in the log."""
        return any(event.text.startswith("ended: ") for event in self.log.events)

    def states(self) -> list[int]:
        column = self.log.cycle["state"].astype(int)
        return [int(s) for k, s in enumerate(column) if k == 0 or s != column[k - 1]]

    def safe_after_s(self) -> float:
        """Rig time from which on no joint has torque or moves."""
        busy = (self.rig["tau_applied"] != 0.0) | (self.rig["v"] != 0.0)
        moving = np.flatnonzero(busy.any(axis=1))
        assert moving.size, "the arm never moved: nothing is proven"
        assert moving[-1] + 1 < self.rig["t"].size, "the log ends before the arm is safe"
        return float(self.rig["t"][moving[-1] + 1])


def logged(folder: Path) -> Run | None:
    """Return the run in its files, recovered where they are torn; None where no cycle is in one."""
    whole = []
    for k, path in enumerate(sorted(folder.glob("run*.mcap"), key=lambda p: (len(p.name), p.name))):
        if is_torn(path):
            try:
                recover(path, folder / f"whole{k}")
            except LogError as error:
                assert path.stat().st_size < EMPTY_BYTES, error  # noqa: PT017 - it never began
                continue
            path = folder / f"whole{k}"
        whole.append(path)
    if not whole:
        return None
    began = False
    for path in whole:
        try:
            began = bool(read_piece(path).cycle) or began
        except LogError as error:
            assert "no topic /cycle" in str(error)  # noqa: PT017 - it ended before a record came
    return read_pieces(whole)[0] if began else None


def arguments(folder: Path, duration_s: float = 600.0) -> list[str | Path]:
    return [
        "hil", SCENARIO, "--bus", "unix", "--no-report", "--log", folder / "run.mcap", *PATIENT,
        "--set", f"duration_s={duration_s}", "--set", "fault=[]",
        "--set", "supervisor.overruns_in_a_row=1000",
    ]  # fmt: skip


def leaves_nothing(run: Started, pids: set[int]) -> None:
    """No process, no bus directory, no named shared memory, no line of Python's."""
    until(lambda: all(gone(pid) for pid in pids), "the children to end")
    until(lambda: not list(run.folder.glob("dftc-*")), "the bus directory to go")
    assert not [p for p in Path("/dev/shm").glob("*dftc*") if p.stat().st_uid == os.getuid()]
    assert "Traceback" not in run.err


def survive(
    server: ForkServer,
    folder: Path,
    act: Callable[[Started], None] = lambda run: None,
    *,
    breaks: tuple[str, ...] = (),
    duration_s: float = 600.0,
    settings: tuple[str, ...] = (),
) -> Survived:
    """Start a run, let it move, do something to it, and see what is left."""
    extra = [word for setting in settings for word in ("--set", setting)]
    work = folder / "work"
    with server.start(work, [*arguments(folder, duration_s), *extra], breaks) as run:
        log = folder / "run.mcap"
        run.until(lambda: set(run.children()) >= NAMES, "the processes to start")
        pids = set(run.children().values())
        run.until(lambda: log.exists() and log.stat().st_size > 60_000, "the run to move")
        act(run)
        pids |= set(run.children().values())
        code = run.end()
        leaves_nothing(run, pids)
        found = logged(folder)
        assert found, run.err
        return Survived(code, run.err, found)


def to(name: str, number: int) -> Callable[[Started], None]:
    """Send a signal to one of the processes."""
    return lambda run: os.kill(run.children()[name], number)
