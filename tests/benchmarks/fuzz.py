"""A million made-up frames, and thousands of bad files: what becomes of them."""

from __future__ import annotations

import os
import random
import sys
import tempfile
import traceback
from collections import Counter
from functools import cache
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from dftc_rt.cli.session import Session, open_session
from tests.benchmarks.result import Aim, Result, Table
from tests.fuzz import files, wire

FRAMES = 1_000_000
EXAMPLES = 2000  # of each kind of file


def run(quick: bool) -> Result:
    """Draw with a seed that is printed; ``DFTC_FUZZ_SEED`` draws the same again."""
    start = int(os.environ.get("DFTC_FUZZ_SEED", random.SystemRandom().randrange(10**6)))
    print(f"fuzz: DFTC_FUZZ_SEED={start}", file=sys.stderr, flush=True)
    failed: list[str] = []
    frames = _frames(start, FRAMES // 50 if quick else FRAMES, failed)
    kinds = _files(start, 20 if quick else EXAMPLES, failed)
    return Result(
        "fuzz",
        [
            Table(f"Frames made up, seed {start}", ("profile", "frames", "runs", "ended"), frames),
            Table("Bad files", ("kind", "files", "refused", "failed in a run", "taken"), kinds),
        ],
        [Aim("tracebacks, hangs, too much memory or torque", "<=", 0.0, float(len(failed)))],
        failed,
    )


def _told(error: BaseException) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error!s:.200} ({Path(last.filename).name}:{last.lineno})"


def _frames(start: int, least: int, failed: list[str]) -> list[tuple[str, int, int, str]]:
    """Run until so many frames were made up."""
    made: Counter[str] = Counter()
    runs: Counter[str] = Counter()
    ended: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = files.write(Path(folder) / "s.toml", files.SCENARIO.encode())

        @cache
        def opened(profile: str) -> Session:
            return open_session(path, wire.settings(profile))

        number = start
        while made.total() < least:
            for profile, run, at in wire.campaign(opened, range(number, number + 1), (3, 40, 200)):
                runs[profile] += 1
                if isinstance(run, BaseException):
                    failed.append(f"frames to {profile}, seed {at}: {_told(run)}")
                    continue
                made[profile] += run.made
                ended.setdefault(profile, Counter())[run.outcome] += 1
            number += 1
    return [
        (name, made[name], runs[name], ", ".join(f"{k} {v}" for k, v in ended[name].most_common()))
        for name in ended
    ]


def _files(start: int, examples: int, failed: list[str]) -> list[tuple[str, int, int, int, int]]:
    """Draw so many of each kind."""
    rows = []
    for kind in files.every_kind():
        ended = _drawn(kind, start, examples, failed)
        total = ended.total()
        rows.append((kind.name, total, ended["refused"], ended["failed"], ended["accepted"]))
    return rows


def _drawn(kind: files.Kind, start: int, examples: int, failed: list[str]) -> Counter[str]:
    ended: Counter[str] = Counter()

    @seed(start)
    @settings(
        max_examples=examples, deadline=None, database=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(kind.content)
    def one(content: bytes) -> None:
        try:
            ended[files.survive(kind, content)] += 1
        except (Exception, files.HangsError) as error:
            ended["broke"] += 1
            failed.append(f"{kind.name}: {_told(error)}")

    one()
    return ended
