"""``dftc hil`` in real time, beside cyclictest on the same core before and after it."""

from __future__ import annotations

import tempfile
from pathlib import Path

from dftc_rt.cli.processes.roles import CONTROLLER_PRIORITY
from dftc_rt.errors import EnvironmentLacksError
from dftc_rt.rt.process import last_core
from tests.benchmarks import cyclictest
from tests.benchmarks.processes import hil
from tests.benchmarks.result import Aim, Result, Table

SCENARIO = "panda_shoulder_loss"
PERIOD_US = 1000
_ALLOWED = 0.001  # of the cycles, besides what cyclictest itself misses


def run(quick: bool = False) -> Result:
    """Measure.

    Args:
        quick: A few seconds, to see that it works.
    """
    seconds = 2 if quick else 60
    core = last_core()
    notes = [f"core {core}, cyclictest at priority {CONTROLLER_PRIORITY}, 1 kHz each"]
    floors: list[cyclictest.Lateness] = []
    with tempfile.TemporaryDirectory(prefix="dftc-benchmark-") as folder:
        _floor(core, max(seconds // 2, 1), floors, notes)
        found = hil(SCENARIO, seconds, (), Path(folder))
        _floor(core, max(seconds // 2, 1), floors, notes)
    cycles = found["cycles"]
    rows: list[tuple[str | float | None, ...]] = [
        (f"cyclictest {when}", f.samples, f.p50_us, f.p99_us, f.max_us, f.late, None, None)
        for when, f in zip(("before", "after"), floors, strict=False)
    ]
    lateness = found["lateness_us"]
    dropped = sum(found["recorder_dropped"].values())
    rows.insert(
        1,
        (
            "dftc hil", cycles, lateness["p50"], lateness["p99"], lateness["max"], None,
            found["overruns"], dropped,
        ),
    )  # fmt: skip
    timings = [
        (what, found[key]["p50"], found[key]["p99"], found[key]["max"])
        for what, key in (
            ("lateness", "lateness_us"), ("exchange", "exchange_us"), ("compute", "compute_us"),
        )
    ]  # fmt: skip
    notes += found["scheduling"]
    ended = [] if found["end_state"] == "done" else [f"{found['end_state']}: {found['reason']}"]
    aims = [Aim("records dropped by the recorder", "<=", 0.0, float(dropped))]
    if len(floors) == 2:
        late = sum(f.late for f in floors) / sum(f.samples for f in floors) * cycles
        aims.insert(
            0,
            Aim(
                "overruns, against cyclictest's wake-ups over one period (scaled to as many "
                "cycles) + 0.1 % of cycles",
                "<=", late + _ALLOWED * cycles, float(found["overruns"]),
            ),
        )  # fmt: skip
    return Result(
        "realtime",
        [
            Table(
                f"Real time: panda, 7 joints, 3 buses, 1 kHz, {seconds} s; lateness, us",
                ("", "wake-ups", "p50", "p99", "max", "over a period", "overruns", "dropped"),
                rows,
            ),
            Table("The cycle of dftc hil, us", ("", "p50", "p99", "max"), timings),
        ],
        aims,
        [*notes, f"missed answers {found['missed_answers']}", *ended],
    )


def _floor(core: int, seconds: int, floors: list[cyclictest.Lateness], notes: list[str]) -> None:
    """Run cyclictest; a machine without it still gets the other rows."""
    try:
        floors.append(cyclictest.measure(core, seconds, CONTROLLER_PRIORITY, late_us=PERIOD_US))
    except EnvironmentLacksError as error:
        notes.append(f"cyclictest not measured: {error}")
