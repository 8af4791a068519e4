"""``dftc rig`` and controllers that know nothing of this package: the examples, as processes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.realtime

EXAMPLES = Path(__file__).parents[2] / "examples"
LINE = re.compile(r"(\w+) should be at (-?[\d.]+) rad and is at (-?[\d.]+)")


def run(name: str) -> dict[str, tuple[float, float]]:
    """Run an example; return joint -> (where it should be, where the rig says that it is)."""
    done = subprocess.run(
        [sys.executable, EXAMPLES / name], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return {joint: (float(want), float(true)) for joint, want, true in LINE.findall(done.stdout)}


@pytest.mark.parametrize("name", ["own_controller_can.py", "own_controller_canopen.py"])
def test_it_imports_nothing_of_ours_and_fits_on_a_page(name: str) -> None:
    text = (EXAMPLES / name).read_text()
    assert not re.search(r"^\s*(import|from) (dftc_rt|hil)", text, re.MULTILINE)
    assert len(text.splitlines()) <= (60 if "can.py" in name else 80)


def test_python_can_moves_seven_joints_on_three_buses() -> None:
    found = run("own_controller_can.py")
    home = dict(zip(found, (0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.7), strict=True))
    for joint, (wanted, true) in found.items():
        assert abs(true - wanted) < 0.02
        assert abs(true - home[joint]) > 0.1


def test_canopen_moves_a_joint_in_wall_time() -> None:
    found = run("own_controller_canopen.py")
    wanted, true = found["panda_joint1"]
    assert abs(true - wanted) < 0.02
    assert true > 0.4  # it began near 0
