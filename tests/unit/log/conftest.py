"""A small run whose every number differs, as a log and as arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.control.signals import NAMES
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.schema import Layout, cycle_layout, rig_layout

JOINTS = ("shoulder", "elbow.1")
SCENARIO = 'name = "x"\nseed = 1\n'
URDF = '<robot name="ä"/>'


def frames(q: NDArray[np.float64]) -> list[tuple[str, str, NDArray[np.float64], list[float]]]:
    return [
        ("world", "link1", np.array([q[0], 1.0, 2.0]), [0.0, 0.0, 0.0, 1.0]),
        ("link1", "lnk2", np.array([0.0, q[1], 3.0]), [0.5, 0.5, 0.5, 0.5]),
    ]


@dataclass
class Sample:
    """Layouts and records of one run."""

    cycle: Layout
    rig: Layout
    cycles: NDArray[np.float64]
    rigs: NDArray[np.float64]

    def write(self, path: Path, *, block: int = 20, **options: Any) -> None:
        settings = {
            "scenario": SCENARIO,
            "urdf": URDF,
            "versions": {"numpy": "2", "dftc_rt": "0.1.0"},
            "torque_limit": (87.0, 12.0),
            "link_frames": frames,
        }
        with Recorder(path, self.cycle, self.rig, **(settings | options)) as recorder:
            recorder.write_event(0.0, 1, "controller", "läuft")
            for at in range(0, len(self.cycles), block):
                recorder.write_cycles(self.cycles[at : at + block])
                recorder.write_rig(self.rigs[at : at + block])
                recorder.flush_due(self.cycles[at, 0])
            recorder.write_event(0.25, 3, "can0", "bus off")


@pytest.fixture
def sample() -> Sample:
    return make_sample(700)


def make_sample(count: int) -> Sample:
    cycle, rig = cycle_layout(JOINTS, NAMES), rig_layout(JOINTS)
    rng = np.random.default_rng(5)
    cycles = rng.standard_normal((count, cycle.size))
    rigs = rng.standard_normal((count, rig.size))
    cycles[:, 0] = rigs[:, 0] = np.arange(count) * 0.001
    return Sample(cycle, rig, cycles, rigs)


@pytest.fixture
def log(sample: Sample, tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    sample.write(path)
    return path


Maker = Callable[[int], Sample]


@pytest.fixture
def maker() -> Maker:
    return make_sample
