"""The recorder's loop between rings and log."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.errors import EnvironmentLacksError
from dftc_rt.log.process import record
from dftc_rt.log.reader import read
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.recover import recover
from dftc_rt.ring import EventRing, Ring

from .conftest import Sample

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parents[3]


class Rings:
    """The three rings, and writers that go on with each wait of the recorder."""

    def __init__(self, sample: Sample, slots: int = 64, per_wait: int = 50) -> None:
        self.sample = sample
        self.cycle = Ring.create("cycle", slots, sample.cycle.size)
        self.rig = Ring.create("rig", slots, sample.rig.size)
        self.events = EventRing.create("events", 16)
        self.per_wait = per_wait
        self.at = 0
        self.now = 0.0

    def write(self, count: int) -> None:
        for k in range(self.at, min(self.at + count, len(self.sample.cycles))):
            for ring, records in ((self.cycle, self.sample.cycles), (self.rig, self.sample.rigs)):
                ring.slot()[:] = records[k]
                ring.commit()
        self.at += count

    def end(self) -> None:
        for ring in (self.cycle, self.rig, self.events):
            ring.end()

    def wait(self, seconds: float) -> None:
        self.now += seconds
        self.write(self.per_wait)
        if self.at >= len(self.sample.cycles):
            self.end()


def never() -> bool:
    return False


def test_everything_reaches_the_log(sample: Sample, tmp_path: Path) -> None:
    rings = Rings(sample)
    rings.events.write(0.5, 2, "can0", "late")
    with Recorder(tmp_path / "x.mcap", sample.cycle, sample.rig) as recorder:
        done = record(
            rings.cycle, rings.rig, [rings.events], recorder, never,
            wait=rings.wait, clock=lambda: rings.now,
        )  # fmt: skip
    assert (done.cycles, done.rig, done.events) == (700, 700, 1)
    assert done.finished
    assert set(done.dropped.values()) == {0}
    run = read(tmp_path / "x.mcap")
    np.testing.assert_array_equal(run.cycle["t"], sample.cycles[:, 0])
    assert [event.text for event in run.events] == ["late"]


def test_drops_are_counted_and_told(sample: Sample, tmp_path: Path) -> None:
    rings = Rings(sample, slots=64, per_wait=100)
    with Recorder(tmp_path / "x.mcap", sample.cycle, sample.rig) as recorder:
        done = record(
            rings.cycle, rings.rig, [rings.events], recorder, never,
            wait=rings.wait, clock=lambda: rings.now,
        )  # fmt: skip
    assert done.cycles == 7 * 64
    assert done.dropped == {"cycle": 7 * 36, "rig": 7 * 36, "events 0": 0}
    told = [event for event in read(tmp_path / "x.mcap").events if event.source == "recorder"]
    assert len(told) == 14
    assert told[0].text == "36 records of ring 'cycle' dropped: it was full"


def test_stop_logs_what_is_there_and_returns(sample: Sample, tmp_path: Path) -> None:
    rings = Rings(sample)
    rings.write(40)
    with Recorder(tmp_path / "x.mcap", sample.cycle, sample.rig) as recorder:
        done = record(rings.cycle, rings.rig, [], recorder, lambda: True, wait=rings.wait)
    assert (done.cycles, done.rig, done.finished) == (40, 40, False)
    assert len(read(tmp_path / "x.mcap").cycle["t"]) == 40


def test_without_a_rig(sample: Sample, tmp_path: Path) -> None:
    rings = Rings(sample)
    with Recorder(tmp_path / "x.mcap", sample.cycle) as recorder:
        done = record(rings.cycle, None, [rings.events], recorder, never, wait=rings.wait)
    assert (done.cycles, done.rig) == (700, 0)


def test_a_full_disk_ends_the_recorder_alone(sample: Sample, tmp_path: Path) -> None:
    rings = Rings(sample)
    recorder = Recorder(tmp_path / "x.mcap", sample.cycle, sample.rig)
    full = open("/dev/full", "wb", buffering=0)  # noqa: SIM115
    recorder._file._raw.close()
    recorder._file._raw = full
    with pytest.raises(EnvironmentLacksError, match="no space left"):
        record(
            rings.cycle, rings.rig, [rings.events], recorder, never,
            wait=rings.wait, clock=lambda: rings.now,
        )  # fmt: skip
    with pytest.raises(EnvironmentLacksError, match="no space left"):
        recorder.close()
    rings.write(1)  # the writers go on
    assert full.closed


_RECORDER = """
import sys, threading
from dftc_rt.log.process import record
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.schema import cycle_layout
from dftc_rt.control.signals import NAMES
from dftc_rt.ring import Ring
ring = Ring.attach(int(sys.argv[1]))
recorder = Recorder(sys.argv[2], cycle_layout(["a", "b"], NAMES))
passes = 0
def wait(seconds):
    global passes
    passes += 1
    if passes == 3:  # what was written is flushed: kill me now
        sys.stdout.write("x")
        sys.stdout.flush()
        sys.stdin.read()
record(ring, None, [], recorder, lambda: False, wait=wait, clock=lambda: float(passes))
"""


def test_a_killed_recorder_keeps_what_it_flushed(sample: Sample, tmp_path: Path) -> None:
    ring = Ring.create("cycle", 1024, sample.cycle.size)
    for row in sample.cycles:
        ring.slot()[:] = row
        ring.commit()
    path, saved = tmp_path / "x.mcap", tmp_path / "saved.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", _RECORDER, str(ring.fd), str(path)],
        cwd=ROOT, pass_fds=[ring.fd], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    assert child.stdout is not None
    assert child.stdout.read(1) == b"x"
    child.send_signal(signal.SIGKILL)
    child.communicate()
    assert child.returncode == -signal.SIGKILL
    recover(path, saved)
    np.testing.assert_array_equal(read(saved).cycle["t"], sample.cycles[:, 0])
    assert ring.pending == 0  # and its successor goes on behind it
