"""Scenario files: strict, resolved, and the same after a round trip."""

from __future__ import annotations

from pathlib import Path

import pytest

from dftc_rt.config.load import from_text, load_scenario
from dftc_rt.errors import InputError, MissingFileError
from hil import SCENARIOS

SMALL = 'name = "small"\n[robot]\nname = "ur5"\n'


def write(folder: Path, text: str) -> Path:
    path = folder / "s.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda p: p.stem)
def test_shipped_scenarios_survive_a_round_trip(path: Path) -> None:
    loaded = load_scenario(path)
    assert from_text(loaded.text) == loaded.scenario


def test_resolved_text_writes_defaults_out(tmp_path: Path) -> None:
    text = load_scenario(write(tmp_path, SMALL), ["rig.drive.watchdog_s=0.03"]).text
    assert "watchdog_s = 0.03" in text
    assert "stale_cycles = 20" in text
    assert 'overrun = "skip"' in text


def test_bare_name_is_a_shipped_scenario_unless_there_is_such_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_scenario("ur5_elbow_loss", shipped=SCENARIOS).scenario.name == "ur5-elbow-loss"
    Path("ur5_elbow_loss").write_text(SMALL)
    assert load_scenario("ur5_elbow_loss", shipped=SCENARIOS).scenario.name == "small"
    with pytest.raises(MissingFileError, match="panda_shoulder_loss"):
        load_scenario("nothing", shipped=SCENARIOS)


@pytest.mark.parametrize(
    ("setting", "where"),
    [
        ("executor.rate=5", "executor.rate"),
        ("executor.rate_hz=0", "executor.rate_hz"),
        ("executor.rate_hz=fast", "executor.rate_hz"),
        ("executor.overrun=ignore", "executor.overrun"),
        ("supervisor.rho_min=1.0", "supervisor.rho_min"),
        ("supervisor.stale_cycles=1.5", "supervisor.stale_cycles"),
        ("rig.plant.substeps=0", "rig.plant.substeps"),
        ("rig.drive.encoder_bits=40", "rig.drive.encoder_bits"),
        ("reference.kind=waltz", "reference.kind"),
        ("control.interconnection=guessed", "control.interconnection"),
        ('fault=[{joint="a", kind="loss"}]', "fault[0]"),
        ('fault=[{joint="a", kind="loss", effectiveness=1.5}]', "fault[0].effectiveness"),
        ('fault=[{joint="a", kind="loss", effectiveness=0.5, to=1.0}]', "fault[0].to"),
        ('fault=[{joint="a", kind="total", start_s=3.0, end_s=2.0}]', "fault[0].end_s"),
        ("name=a b", "name"),
        ('robot.urdf="x.urdf"', "robot: found name and urdf (expected one of name, urdf, plant)"),
        ("robot.plant=arm2", "robot: found name and plant (expected one of name, urdf, plant)"),
        ("robot={}", "robot: found none of them (expected one of name, urdf, plant)"),
        ("robot={plant='wheel'}",
         "robot.plant: found 'wheel' (expected one of pendulums, pendulums_physical, arm2)"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_with_its_path(setting: str, where: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_scenario(write(tmp_path, SMALL), [setting])
    assert where in str(caught.value)
    assert "\n" not in str(caught.value)


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    (tmp_path / "motion.csv").write_text("t,q\n0,0\n1,1\n")
    text = SMALL + '[reference]\nkind = "csv"\nfile = "motion.csv"\n'
    found = load_scenario(write(tmp_path, text)).scenario.reference.file
    assert found == str(tmp_path / "motion.csv")
