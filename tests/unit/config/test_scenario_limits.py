"""Scenario values that a range check alone would let pass: each one line, none a traceback."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dftc_rt.config.load import load_scenario
from dftc_rt.config.scenario import ReferenceTable
from dftc_rt.errors import InputError
from dftc_rt.reference import Reference
from hil import SCENARIOS


@pytest.mark.parametrize(
    ("setting", "what"),
    [
        ("control.gains.k=inf", "control.gains.k: found inf"),
        ("rig.plant.q0_rad=[inf, 0.0]", r"rig.plant.q0_rad\[0\]: found inf"),
        ("seed=-1", "seed: found -1"),
        ("reference.seed=-1", "reference.seed: found -1"),
        ("rig.plant.viscous=-1", "rig.plant.viscous: found -1"),
        ("rig.plant.friction=x", "rig.plant.friction: found 'x' .expected one of coulomb, lugre"),
        ("rig.plant.stribeck=0.9", "rig.plant.stribeck: found 0.9 .expected a number >= 1"),
        ("rig.plant.presliding_rad=0", "rig.plant.presliding_rad: found 0 "),
        ("rig.plant.torque_constant=[1.0, 0.0]", "rig.plant.torque_constant"),
        ('fault=[{kind="payload"}]', r"fault\[0\].payload_kg: missing"),
        ('fault=[{kind="payload", payload_kg=inf}]', r"fault\[0\].payload_kg: found inf"),
        ('fault=[{kind="contact", force_n=[1.0, 2.0]}]', r"fault\[0\].force_n"),
        ('fault=[{kind="friction", factor=-1.0}]', r"fault\[0\].factor: found -1.0"),
        ('fault=[{kind="bias", torque_nm=1.0}]', r"fault\[0\].joint: missing"),
        ('fault=[{kind="bia", torque_nm=1.0}]', r"fault\[0\].kind: found 'bia' .expected one of"),
        ('fault=[{kind="lag", joint="panda_joint1", lag_s=0}]', r"fault\[0\].lag_s: found 0 "),
        ("bus.interface=x", "bus.interface: found 'x'"),
        ("rig.drive.watchdog_s=1e-9", "watchdog_s: 1e-09 s is less than two periods"),
        ("supervisor.stop_ramp_s=1e9", "stop_ramp_s: found 1000000000"),
        (".".join("a" * 3000) + "=1", "nested too deeply"),
    ],
)
def test_it_is_refused_with_its_key(setting: str, what: str) -> None:
    with pytest.raises(InputError, match=what) as caught:
        load_scenario("panda_shoulder_loss", [setting], SCENARIOS)
    assert "\n" not in str(caught.value)


def test_a_path_that_cannot_be_one() -> None:
    with pytest.raises(InputError, match="too long"):
        load_scenario("x" * 5000, (), SCENARIOS)


def test_a_csv_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "b.csv"
    path.write_bytes(b"\xff\xfe\x00,1\n")
    with pytest.raises(InputError, match="cannot be read"):
        Reference(ReferenceTable(kind="csv", file=str(path)), np.zeros(2))
