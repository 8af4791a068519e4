"""Ten minutes of faults drawn at random, in real time: how runs end, and what they leave."""

from __future__ import annotations

import os
import random
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

from tests.benchmarks.result import Aim, Result, Table, seconds_of
from tests.integration.chaos import draw, endure
from tests.integration.forked import ForkServer
from tests.integration.survival import SCENARIO

MINUTES = 10.0


def run(quick: bool) -> Result:
    """Draw until the time is over; what does not hold is told with its draw, and goes on."""
    seed = int(os.environ.get("DFTC_CHAOS_SEED", random.SystemRandom().randrange(10**6)))
    print(f"chaos: DFTC_CHAOS_SEED={seed}", file=sys.stderr, flush=True)
    random_ = random.Random(seed)
    codes: Counter[str] = Counter()
    failed: list[str] = []
    runs = 0
    server = ForkServer(SCENARIO, ["fault=[]"])
    until = time.monotonic() + seconds_of(10.0 if quick else 60.0 * MINUTES)
    with tempfile.TemporaryDirectory(prefix="chaos-") as folder:
        while time.monotonic() < until or not runs:
            drawn = draw(random_)
            try:
                ended = endure(server, Path(folder) / str(runs), drawn)
                codes["no cycle" if ended is None else str(ended.code)] += 1
            except (AssertionError, TimeoutError) as error:
                failed.append(f"run {runs}: {drawn}: {_told(error)}")
            runs += 1
    server.close()
    rows = [(code, count) for code, count in sorted(codes.items())]
    return Result(
        "chaos",
        [Table(f"Runs by exit code, seed {seed}", ("exit code", "runs"), [*rows, ("all", runs)])],
        [Aim("runs that broke a rule", "<=", 0.0, float(len(failed)))],
        failed,
    )


def _told(error: Exception) -> str:
    """One line; of an assertion without words, where it is."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(last.filename).name}:{last.lineno}"
    return f"{str(error).partition(chr(10))[0] or type(error).__name__} ({place})"
