"""One run of ``dftc paper`` for all tests of this folder that need it: a minute or two."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.integration.commands import DFTC

_DEADLINE_S = 1800.0  # far more than it takes, also on a busy machine


@dataclass(frozen=True)
class PaperRun:
    folder: Path
    stdout: str
    stderr: str
    summary: dict[str, Any]


@pytest.fixture(scope="session")
def paper_run(tmp_path_factory: pytest.TempPathFactory) -> PaperRun:
    folder = tmp_path_factory.mktemp("paper")
    command = [DFTC, "paper", "-o", str(folder), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_DEADLINE_S)
    assert done.returncode == 0, done.stderr
    return PaperRun(folder, done.stdout, done.stderr, json.loads(done.stdout))
