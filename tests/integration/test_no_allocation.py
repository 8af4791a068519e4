"""The cycle does not allocate what stays: blocks and bytes of thousands of cycles are constant."""

from __future__ import annotations

import gc
import sys
import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.cli.session import open_session
from dftc_rt.controller import connect
from dftc_rt.rt.clock import LockstepClock
from hil.simulate import in_process_rig

WARM, TRACED, MEASURED = 1000, 1000, 3000
KEPT_BLOCKS = 20  # of Python objects, in all: one in a hundred cycles would be more
KEPT_BYTES = 4096
PEAK_BYTES = 64 * 1024  # of what lives for a cycle


class OneSlot:
    """A sink that keeps the last record."""

    def __init__(self, width: int) -> None:
        self._slot: NDArray[np.float64] = np.empty(width)

    def slot(self) -> NDArray[np.float64]:
        return self._slot

    def commit(self) -> bool:
        return True


@pytest.mark.parametrize("profile", ["cia402", "mit", "moteus"])
@pytest.mark.parametrize("law", ["dftc", "computed_torque"])
def test_the_cycle_keeps_nothing(profile: str, law: str) -> None:
    opened = open_session(
        "paper_example2_urdf",
        [
            f"bus.profile={profile}", f"control.law={law}", "fault=[]", "reference.kind=hold",
            f"duration_s={(WARM + MEASURED + 500) / 1000}", "supervisor.tracking_error_rad=3",
            "bus.overload=allow",
        ],
    )  # fmt: skip
    cycle, truth = OneSlot(opened.cycle.size), OneSlot(opened.rig.size)
    motion = np.empty((3, opened.robot.n))
    opened.parts.reference.target(0.0, motion)
    joined = in_process_rig(opened.scenario, opened.robot, motion, truth, lambda *_: None)
    blocks: list[int] = []
    memory: list[tuple[int, int]] = []
    count = 0

    def once_a_cycle() -> bool:
        nonlocal count
        count += 1
        if count == WARM:
            gc.collect()
            gc.freeze()
            gc.disable()
            tracemalloc.start()
            blocks.append(sys.getallocatedblocks())
        elif count == WARM + TRACED:  # tracing, and caches of its own size, have what they take
            tracemalloc.reset_peak()
            memory.append(tracemalloc.get_traced_memory())
            blocks.append(sys.getallocatedblocks())
        elif count == WARM + MEASURED:
            blocks.append(sys.getallocatedblocks())
            memory.append(tracemalloc.get_traced_memory())
            tracemalloc.stop()
        return False

    executor = connect(
        opened.scenario, opened.parts, joined.sockets, LockstepClock(), cycle, lambda *_: None,
        once_a_cycle,
    )  # fmt: skip
    try:
        assert executor.run().end_state == "done"
    finally:
        tracemalloc.stop()
        gc.enable()
        gc.unfreeze()
    assert blocks[2] - blocks[1] <= KEPT_BLOCKS
    (before, _), (after, peak) = memory
    assert after - before <= KEPT_BYTES
    assert peak - before <= PEAK_BYTES
