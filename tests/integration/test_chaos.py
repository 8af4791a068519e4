"""A short run of chaos; ``make benchmark`` has ten minutes of it."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest

from tests.integration.chaos import draw, endure
from tests.integration.forked import ForkServer
from tests.integration.survival import SCENARIO

pytestmark = pytest.mark.realtime

RUNS = 5


def test_whatever_is_drawn_is_survived(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    seed = int(os.environ.get("DFTC_CHAOS_SEED", random.SystemRandom().randrange(10**6)))
    random_ = random.Random(seed)
    server = ForkServer(SCENARIO, ["fault=[]"])
    try:
        for number in range(RUNS):
            drawn = draw(random_)
            with capsys.disabled():
                print(f"\n  chaos {number}, DFTC_CHAOS_SEED={seed}: {drawn}", end="")
            endure(server, tmp_path / str(number), drawn)
    finally:
        server.close()
