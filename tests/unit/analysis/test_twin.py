"""A twin is the same run without its faults, and nothing else."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dftc_rt.analysis.metrics import evaluate
from dftc_rt.errors import InputError
from dftc_rt.log.run import Run
from dftc_rt.rt.supervisor import State

from .conftest import Maker

SCENARIO = """
name = "x"
seed = 1
duration_s = 10.0
[robot]
urdf = "/here/arm.urdf"
[reference]
kind = "sine"
seed = 7
[control]
law = "dftc"
ftc = true
[control.gains]
[executor]
rate_hz = 100.0
overrun = "skip"
[rig.plant]
payload_kg = 0.0
"""
FAULT = '[[fault]]\njoint = "a"\nkind = "loss"\nstart_s = 4.0\neffectiveness = 0.6\n'


def refused(run: Run, twin: Run) -> str:
    with pytest.raises(InputError) as caught:
        evaluate(run, twin=twin, twin_name="--twin t.mcap")
    line = str(caught.value)
    assert line.startswith("--twin t.mcap: ")
    assert "\n" not in line
    return line


@pytest.mark.parametrize(
    ("found", "instead", "words"),
    [
        ("seed = 1", "seed = 2", "seed is 2 (expected 1)"),
        ("seed = 7", "seed = 8", "reference.seed is 8 (expected 7)"),
        ('kind = "sine"', 'kind = "hold"', "reference.kind is hold (expected sine)"),
        ("arm.urdf", "leg.urdf", "robot.urdf is /here/leg.urdf"),
        ('law = "dftc"', 'law = "paper"', "control.law is paper (expected dftc)"),
        ("[control.gains]", "[control.gains]\nk = 3", "control.gains.k is 3 (expected not set)"),
        ("rate_hz = 100.0", "rate_hz = 50.0", "executor.rate_hz is 50.0 (expected 100.0)"),
        ("payload_kg = 0.0", "payload_kg = 1.0", "rig.plant.payload_kg is 1.0 (expected 0.0)"),
        ("[rig.plant]", "[rig.drive]\nencoder_bits = 12\n[rig.plant]", "rig.drive is"),
    ],
)
def test_what_moves_the_robot_must_agree(make: Maker, found: str, instead: str, words: str) -> None:
    assert SCENARIO.count(found) == 1
    assert words in refused(make(SCENARIO + FAULT), make(SCENARIO.replace(found, instead)))


def test_what_changes_nothing_may_differ(make: Maker) -> None:
    run, other = make(SCENARIO + FAULT), SCENARIO
    for found, instead in (
        ('"x"', '"y"'), ("ftc = true", "ftc = false"), ("duration_s = 10.0", "duration_s = 12.0"),
        ('overrun = "skip"', 'overrun = "stop"'),
        ("[executor]", '[bus]\ninterface = "unix"\n[supervisor]\nstale_cycles = 9\n[executor]'),
    ):  # fmt: skip
        assert other.count(found) == 1
        other = other.replace(found, instead)
    twin = make(other, seconds=12.0)
    twin.cycle["qd"][:] = 0.001
    metrics = evaluate(run, twin=twin)
    assert metrics["joints"]["a"]["rmse_twin_mrad"] == pytest.approx(1.0)


def test_other_joints_and_other_robots_are_refused(make: Maker) -> None:
    run = make(SCENARIO + FAULT)
    assert "joints b, a" in refused(run, dataclasses.replace(make(SCENARIO), joints=("b", "a")))
    ours = dataclasses.replace(run, urdf="<robot/>")
    line = refused(ours, dataclasses.replace(make(SCENARIO), urdf="<robot name='b'/>"))
    assert "URDF differs" in line
    moved = make(SCENARIO.replace("/here/", "/there/"))  # the same robot, from another folder
    evaluate(ours, twin=dataclasses.replace(moved, urdf="<robot/>"))


def test_the_twin_must_last_as_long(make: Maker) -> None:
    run = make(SCENARIO + FAULT)
    line = refused(run, make(SCENARIO, seconds=6.0))
    assert "runs from 0.00 to 5.99 s (expected 0.00 to 9.99 s" in line
    assert "does not run" in refused(run, make(SCENARIO, seconds=0.0))
    stopped = make(SCENARIO)
    stopped.cycle["state"][500:] = State.SAFE_STOP
    assert "runs from 0.00 to 4.99 s" in refused(run, stopped)
    run.cycle["state"][400:] = State.SAFE_STOP  # then the twin need not last longer
    evaluate(run, twin=stopped)


def test_a_twin_with_a_fault_is_none(make: Maker) -> None:
    assert "a fault itself, on a" in refused(make(SCENARIO + FAULT), make(SCENARIO + FAULT))
    later = FAULT.replace("4.0", "11.0")
    evaluate(make(SCENARIO + FAULT), twin=make(SCENARIO + later, seconds=12.0))


def test_logs_without_a_scenario_are_compared_by_rate(make: Maker) -> None:
    run, twin = make(), make(seconds=20.0)
    twin.cycle["t"] *= 0.5
    assert "200 cycles a second (expected 100)" in refused(run, twin)
    evaluate(run, twin=make())
    assert np.ptp(twin.cycle["t"]) < 10.0
