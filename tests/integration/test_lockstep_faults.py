"""Lock-step under faults of a bus: the same run, however its frames are cut into batches.

Over sockets the rig wakes up for a first frame and finds as many as have been written by then.
Here the frames of each batch come in pieces of random size, in one process, so that what takes
luck over sockets is certain.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.cli.main import run
from dftc_rt.cli.session import open_session
from dftc_rt.controller import connect
from dftc_rt.memory import MemorySink
from dftc_rt.rt.clock import LockstepClock
from hil.simulate import in_process_rig
from tests.integration.commands import WALL_FIELDS, dftc, repeatable

FAULTS = (
    'fault=[{bus="can0", kind="frame_duplication", probability=0.2},'
    ' {bus="can0", kind="frame_delay", delay_s=0.0015, probability=0.2},'
    ' {bus="can0", kind="frame_loss", probability=0.1}]'
)
PROFILES = {
    "cia402": ["bus.profile=cia402"],
    "mit": ["bus.profile=mit"],
    "moteus": ["bus.profile=moteus", "robot.joints_per_bus=4"],
}
ALWAYS = ["duration_s=0.1", "supervisor.stale_cycles=100", FAULTS]


class Piecemeal:
    """A socket that sends each batch in pieces; a ``FrameSocket``."""

    def __init__(self, socket: FrameSocket, rng: np.random.Generator) -> None:
        self.socket = socket
        self.rng = rng
        self.name, self.fd = socket.name, socket.fd

    def send(self, frames: Frames, count: int) -> int:
        row = 0
        while row < count:
            piece = int(self.rng.integers(1, count - row + 1))
            assert self.socket.send(np.ascontiguousarray(frames[row:]), piece) == piece
            row += piece
        return count

    def receive(self, frames: Frames) -> int:
        return self.socket.receive(frames)

    def close(self) -> None:
        self.socket.close()


def records(settings: list[str], seed: int | None) -> tuple[NDArray[np.float64], bytes, str]:
    """Run; return /cycle without wall times, /rig, and how it ended."""
    opened = open_session("panda_shoulder_loss", settings)
    motion = np.empty((3, opened.robot.n))
    opened.parts.reference.target(0.0, motion)
    truth, cycles = MemorySink(opened.rig.size), MemorySink(opened.cycle.size)
    joined = in_process_rig(opened.scenario, opened.robot, motion, truth, lambda *_: None)
    sockets = joined.sockets
    if seed is not None:
        rng = np.random.default_rng(seed)
        sockets = [Piecemeal(socket, rng) for socket in sockets]
    executor = connect(
        opened.scenario, opened.parts, sockets, LockstepClock(), cycles, lambda *_: None,
        lambda: False,
    )  # fmt: skip
    outcome = executor.run()
    found = cycles.records().copy()
    found[:, WALL_FIELDS] = 0.0
    return found, truth.records().tobytes(), outcome.end_state


@pytest.mark.parametrize("profile", PROFILES)
def test_frames_that_come_in_pieces_make_no_difference(profile: str) -> None:
    settings = [*ALWAYS, *PROFILES[profile]]
    whole, truth, state = records(settings, None)
    assert state == "done"
    assert len(whole) > 400  # 100 cycles, and those of the ramp
    for seed in range(4):
        pieces, true, _ = records(settings, seed)
        np.testing.assert_array_equal(pieces, whole)
        assert true == truth


@pytest.mark.parametrize("profile", PROFILES)
def test_over_sockets_as_in_one_process(profile: str, tmp_path: Path) -> None:
    settings = [word for each in [*ALWAYS, *PROFILES[profile]] for word in ("--set", each)]
    here, there = tmp_path / "here.mcap", tmp_path / "there.mcap"
    assert run(["simulate", "panda_shoulder_loss", "--log", str(here), "--json", *settings]) == 0
    options = ("--lockstep", "--bus", "unix", "--log", there, "--json", "--no-report")
    done = dftc("hil", "panda_shoulder_loss", *options, *settings)
    assert done.returncode == 0, done.stderr
    one, other = repeatable(here), repeatable(there)
    assert len(one[0]) > 400 * 8
    assert other == one
