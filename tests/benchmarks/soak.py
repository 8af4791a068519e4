"""Twenty minutes of ``dftc hil`` in real time: memory, descriptors, drops, lateness.

cyclictest runs in the same minutes on the same core, one priority above the controller, so that
it tells what the machine did to both. ``--seconds`` makes it shorter.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from dftc_rt.cli.processes.roles import CONTROLLER_PRIORITY
from dftc_rt.errors import EnvironmentLacksError
from dftc_rt.rt.process import last_core
from tests.benchmarks import cyclictest
from tests.benchmarks.processes import hil
from tests.benchmarks.result import Aim, Result, Table, seconds_of

SCENARIO = "panda_shoulder_loss"
SECONDS = 1200.0
_SAMPLES = 240  # at most one every half a second
_WARM = 0.2  # of the run, which does not count
_FLAT_KB_PER_MIN = 50.0
_RECORDER = "dftc-recorder"
_INDEX_BYTES = 400.0  # of one chunk of the log, in the recorder's memory
_LAST = 0.95  # of it: what ends the run does not count, either
# Other programs may hold the run up: it goes on, and tells of its overruns.
_PATIENT = (
    "fault=[]", "rig.drive.watchdog_s=0.5", "supervisor.stale_cycles=500",
    "supervisor.overruns_in_a_row=1000000",
)  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """One process at one moment: seconds, its own memory in kB, open descriptors."""

    t: float
    memory_kb: int
    descriptors: int


class Watch(threading.Thread):
    """Looks at the children of a child of this process, until told to end."""

    def __init__(self, every_s: float) -> None:
        super().__init__(daemon=True)
        self.found: defaultdict[str, list[Sample]] = defaultdict(list)
        self._every_s = every_s
        self._ended = threading.Event()

    def run(self) -> None:
        begun = time.monotonic()
        while not self._ended.wait(self._every_s):
            for launcher in _children(os.getpid()):
                for pid in (launcher, *_children(launcher)):
                    with contextlib.suppress(OSError, ValueError, KeyError):  # it has just ended
                        name = Path(f"/proc/{pid}/comm").read_text().strip()
                        sample = Sample(
                            time.monotonic() - begun,
                            _memory_kb(pid),
                            len(os.listdir(f"/proc/{pid}/fd")),
                        )
                        self.found[name].append(sample)

    def end(self) -> dict[str, list[Sample]]:
        """Stop looking; return name -> samples."""
        self._ended.set()
        self.join()
        return dict(self.found)


def _children(pid: int) -> list[int]:
    try:
        tasks = Path(f"/proc/{pid}/task").iterdir()
        return [int(child) for task in tasks for child in (task / "children").read_text().split()]
    except OSError:
        return []


def _memory_kb(pid: int) -> int:
    """Resident memory but for files, whose pages the system takes and gives back as it likes."""
    told = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return sum(int(told[key].split()[0]) for key in ("RssAnon", "RssShmem"))


def slope_kb_per_min(samples: Sequence[Sample]) -> float:
    """Least-squares slope of the memory of one process, kB/min."""
    t = np.array([sample.t for sample in samples]) / 60.0
    memory = np.array([sample.memory_kb for sample in samples], dtype=np.float64)
    return float(np.polyfit(t - t.mean(), memory, 1)[0])


def counted(found: Mapping[str, Sequence[Sample]], seconds: float) -> dict[str, list[Sample]]:
    """What counts of each process: the controller runs, and neither warms up nor ends."""
    loop = found.get("dftc-controller", ())
    if not loop:
        return {}
    first, last = loop[0].t + _WARM * seconds, loop[0].t + _LAST * seconds
    inside = {
        name: [sample for sample in samples if first <= sample.t <= min(last, loop[-1].t)]
        for name, samples in found.items()
        if name.startswith("dftc")
    }
    return {name: samples for name, samples in inside.items() if len(samples) > 4}


def run(quick: bool) -> Result:
    """Run it, and say what grew."""
    seconds = seconds_of(10.0 if quick else SECONDS)
    core = last_core()
    floors: list[cyclictest.Lateness] = []
    notes = [f"{seconds:g} s on core {core}; {_WARM:.0%} of it is warm-up and does not count"]

    def floor() -> None:
        try:
            whole = max(int(seconds), 1)
            floors.append(cyclictest.measure(core, whole, CONTROLLER_PRIORITY + 1, late_us=1000))
        except EnvironmentLacksError as error:
            notes.append(f"cyclictest not measured: {error}")

    beside = threading.Thread(target=floor)
    watch = Watch(max(seconds / _SAMPLES, 0.5))
    with tempfile.TemporaryDirectory(prefix="dftc-soak-") as folder:
        beside.start()
        watch.start()
        found = hil(SCENARIO, seconds, _PATIENT, Path(folder))
        samples = watch.end()
        beside.join()
        chunks = _chunks(Path(found["log"])) / (seconds / 60.0)
    lasting = counted(samples, seconds)
    lateness = found["lateness_us"]
    rows: list[tuple[str | float | None, ...]] = [
        ("dftc hil", found["cycles"], *(lateness[key] for key in ("p50", "p99", "max")))
    ]
    rows += [("cyclictest", f.samples, f.p50_us, f.p99_us, f.max_us) for f in floors]
    dropped = float(sum(found["recorder_dropped"].values()))
    notes.append(f"{chunks:.0f} chunks of the log a minute")
    notes.append(f"overruns {found['overruns']}, missed answers {found['missed_answers']}")
    if found["end_state"] != "done":
        notes.append(f"{found['end_state']}: {found['reason']}")
    return Result(
        "soak",
        [
            Table("Lateness in the same minutes, us", ("", "wake-ups", "p50", "p99", "max"), rows),
            _processes(lasting),
        ],
        [*_aims(lasting, chunks), Aim("records dropped by the recorder", "<=", 0.0, dropped)],
        notes,
    )


def _chunks(log: Path) -> int:
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    return len(summary.chunk_indexes) if summary is not None else 0


def _processes(lasting: Mapping[str, Sequence[Sample]]) -> Table:
    rows = [
        (
            name, len(inside), inside[0].memory_kb, inside[-1].memory_kb, slope_kb_per_min(inside),
            min(s.descriptors for s in inside), max(s.descriptors for s in inside),
        )
        for name, inside in sorted(lasting.items())
    ]  # fmt: skip
    return Table(
        "Processes, after warm-up",
        ("", "samples", "kB first", "kB last", "kB/min", "descriptors", "most"), rows,
    )  # fmt: skip


def _aims(lasting: Mapping[str, Sequence[Sample]], chunks_per_min: float) -> list[Aim]:
    slopes = {name: slope_kb_per_min(inside) for name, inside in lasting.items()}
    recorder = slopes.pop(_RECORDER, None)
    an_index = None if recorder is None else 1024.0 * recorder / chunks_per_min
    moved = [len({s.descriptors for s in inside}) - 1 for inside in lasting.values()]
    steepest = max(slopes.values()) if slopes else None
    return [
        Aim("memory that a process gains, kB/min", "<=", _FLAT_KB_PER_MIN, steepest),
        Aim(
            "that the recorder gains, which keeps its file's index until the end, bytes a chunk",
            "<=", _INDEX_BYTES, an_index,
        ),
        Aim("changes of a process's descriptors", "<=", 0.0, float(max(moved)) if moved else None),
    ]  # fmt: skip
