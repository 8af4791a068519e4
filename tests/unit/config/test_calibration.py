"""Calibration files: what is refused, each in one line."""

from pathlib import Path

import pytest

from dftc_rt.cli.main import run as command
from dftc_rt.config.calibration import load_calibration

LINK = """
[[link]]
joint = "joint2"
mass_kg = 4.0
first_moment_kg_m = [0.0, 0.0, 0.6]
inertia_kg_m2 = [0.1233, 0.0, 0.1233, 0.0, 0.0, 0.01]
"""
JOINTS = """
[[joint]]
name = "joint1"
armature = 0.0
[joint.gains]
inflation = 40.0

[[joint]]
name = "joint2"
armature = 0.0
[joint.gains]
inflation = 40.0
"""
GOOD = 'robot = "arm2"\n' + LINK + JOINTS


def _simulate(path: Path) -> int:
    sets = (f"control.calibration={path}", "duration_s=0.05")
    return command(["simulate", "paper_example2_urdf", *(w for s in sets for w in ("--set", s))])


def test_a_good_file_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "good.toml"
    path.write_text(GOOD)
    assert load_calibration(path).joint[1].torque_constant == 1.0
    assert _simulate(path) == 0


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("mass_kg = 4.0", "mass_kg = 1e300", "link[0].mass_kg"),
        ("mass_kg = 4.0", "mass_kg = -1", "link[0].mass_kg"),
        ("mass_kg = 4.0", "mass_kg = nan", "link[0].mass_kg: nan"),
        ("[0.1233, 0.0, 0.1233, 0.0, 0.0, 0.01]", "[-1.0, 0, 0, 0, 0, 0]", "pseudo-inertia"),
        ("armature = 0.0", "armature = 0.0\ncoulomb = 1e18", "joint[0].coulomb"),
        ("armature = 0.0", "armature = 0.0\noffset = -1e9", "joint[0].offset"),
        ("armature = 0.0", "armature = 0.0\ntorque_constant = 1e-9", "joint[0].torque_constant"),
        ("armature = 0.0", "armature = 0.0\nviscus = 1", "viscus"),
        ("inflation = 40.0", "inflation = 1e300", "joint[0].gains.inflation"),
        ("[joint.gains]\ninflation = 40.0\n\n", "", "the same settings in every joint"),
        ('joint = "joint2"', 'joint = "joint1"', "link: found joint1"),
        ('robot = "arm2"', 'robot = "ur5"', "robot: found 'ur5'"),
        ('robot = "arm2"', 'robot = "arm2"\nformat = 2', "format: found 2"),
        ('name = "joint2"', 'name = "joint1"', "joint: found joint1, joint1"),
        ('robot = "arm2"', "a" + ".a" * 3000 + " = 1", "nested too deeply"),
    ],
)
def test_what_cannot_be_is_refused(
    old: str, new: str, expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.toml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1))
    assert _simulate(path) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert str(path) in error
    assert error.count("\n") == 1


def test_another_file_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "precious.txt"
    path.write_text("precious\n")
    assert command(["calibrate", "paper_example2_urdf", "-o", str(path)]) == 2
    assert path.read_text() == "precious\n"
    assert capsys.readouterr().err.count("\n") == 1
