"""The wheel, installed alone in an empty environment, away from the repository, is complete."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def run(*command: str | Path, cwd: Path) -> str:
    """Run a command in a clean environment, pip's settings kept; return its stdout."""
    keep = ("HOME", "LANG", "PATH", "TMPDIR")
    relative = ("PIP_CONSTRAINT", "PIP_BUILD_CONSTRAINT")  # to the repository, as make sets them
    environment = {
        k: v
        for k, v in os.environ.items()
        if k in keep or (k.startswith("PIP_") and k not in relative)
    }
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "-w", "--no-isolation", "-o", out, ROOT, cwd=out)
    (built,) = out.glob("*.whl")
    return built


@dataclass(frozen=True)
class Installed:
    """An empty environment with the wheel, and a directory to work in."""

    bin: Path
    cwd: Path

    def dftc(self, *arguments: str) -> str:
        return run(self.bin / "dftc", *arguments, cwd=self.cwd)


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    place = tmp_path_factory.mktemp("empty")
    venv.create(place / "venv", with_pip=True)
    python = place / "venv" / "bin" / "python"
    constraints = str(ROOT / "constraints.txt")
    run(python, "-m", "pip", "install", "-q", "-c", constraints, wheel, cwd=place)
    (place / "work").mkdir()
    return Installed(python.parent, place / "work")


def test_wheel_carries_code_and_data_only(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.partition("/")[0] for name in names} == {
        "dftc_rt",
        "hil",
        "dftc_rt-0.1.0.dist-info",
    }
    expected = ["dftc_rt/py.typed", "hil/py.typed"]
    for pattern in ("dftc_rt/**/*.py", "dftc_rt/**/*.eds", "hil/**/*.py", "hil/**/*.toml"):
        expected += [str(p.relative_to(ROOT)) for p in ROOT.glob(pattern)]
    expected += [f"dftc_rt/_{p.relative_to(ROOT)}" for p in ROOT.glob("robots/**/*.*")]
    assert sorted(set(expected) - set(names)) == []


def test_wheel_runs_alone(installed: Installed) -> None:
    python = installed.bin / "python"
    where = run(python, "-c", "import dftc_rt, hil; print(hil.__file__)", cwd=installed.cwd)
    assert str(ROOT) not in where
    shipped = {p.parent.name for p in ROOT.glob("robots/*/robot.toml")}
    listed = json.loads(installed.dftc("robots", "--json"))
    assert {robot["name"] for robot in listed["robots"]} == shipped


def test_wheel_simulates_a_shipped_scenario_by_name(installed: Installed) -> None:
    out = installed.dftc(
        "simulate", "panda_shoulder_loss", "--set", "duration_s=0.5", "--set", "fault=[]", "--json"
    )
    metrics = json.loads(out)
    assert metrics["robot"] == "panda"
    assert metrics["cycles"] >= 500
