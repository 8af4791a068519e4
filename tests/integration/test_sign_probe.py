"""The start-up probe: joints that move as they are pushed, the other way, or not at all."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.cli.session import open_session
from dftc_rt.control import signals
from dftc_rt.controller import connect
from dftc_rt.drives.scale import TORQUE_PER_COUNT
from dftc_rt.log.run import Run
from dftc_rt.memory import MemorySink
from dftc_rt.rt.clock import LockstepClock
from dftc_rt.rt.executor import Outcome
from dftc_rt.rt.supervisor import State
from hil.simulate import in_process_rig

SCENARIO = "paper_example2_urdf"
PROFILES = ("cia402", "mit", "moteus")
HOLD = ("reference.kind='hold'", "fault=[]", "duration_s=0.3", "rig.plant.q0_rad=[0.5, 0.3]")


def started(profile: str, *settings: str, torque: tuple[float, float] = (1.0, 1.0)) -> tuple[
    Run, Outcome, list[str]
]:  # fmt: skip
    """Run in lock-step with drives whose motors give ``torque`` times what they should."""
    opened = open_session(
        SCENARIO, [f"bus.profile={profile}", "control.law=computed_torque", *HOLD, *settings]
    )
    cycles, truth = MemorySink(opened.cycle.size), MemorySink(opened.rig.size)
    motion = np.empty((3, opened.robot.n))
    opened.parts.reference.target(0.0, motion)
    said: list[str] = []

    def event(t: float, severity: int, source: str, text: str) -> None:
        said.append(text)

    joined = in_process_rig(opened.scenario, opened.robot, motion, truth, event)
    joined.rig._scale[TORQUE_PER_COUNT] *= torque
    executor = connect(
        opened.scenario, opened.parts, joined.sockets, LockstepClock(), cycles, event,
        lambda: False,
    )  # fmt: skip
    outcome = executor.run()
    run = Run.from_records(opened.cycle, cycles.records(), truth.records())
    assert not joined.rig.drives.operation_enabled.any()
    return run, outcome, said


@pytest.mark.parametrize("profile", PROFILES)
def test_joints_that_move_as_they_are_pushed_start(profile: str) -> None:
    run, outcome, _ = started(profile, "supervisor.probe=0.05")
    assert (outcome.end_state, outcome.reason) == ("done", "")
    arm = run.cycle["state"] == State.ARM
    q, torque = run.cycle["q"][arm], run.cycle["tau_cmd"][arm]
    assert np.count_nonzero(arm) > 60  # each joint: still, pushed, pushed back, at rest
    assert np.abs(q - q[0]).max() < 0.02
    limit = np.array([200.0, 100.0])
    pushed = torque.max(axis=0) - torque.min(axis=0)
    assert (pushed > 1.5 * 0.05 * limit).all()  # both ways
    assert (run.cycle["state"] == State.RUN).any()


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("joint", [0, 1])
def test_a_joint_that_moves_against_its_torque_is_named_and_nothing_starts(
    profile: str, joint: int
) -> None:
    torque = (-1.0, 1.0) if joint == 0 else (1.0, -1.0)
    hanging = "rig.plant.q0_rad=[3.1, 0.05]"  # it does not fall before its turn comes
    run, outcome, said = started(profile, "supervisor.probe=0.05", hanging, torque=torque)
    assert outcome.end_state == "safe stop"
    assert outcome.reason.startswith(f"joint{joint + 1}: ")
    assert "moves against its torque of" in outcome.reason
    assert f"quick stop: {outcome.reason}" in said
    assert not (run.cycle["state"] == State.RUN).any()
    assert run.rig is not None
    assert np.abs(run.rig["q"] - run.rig["q"][0]).max() < 0.05


def test_one_that_carries_the_arm_away_before_it_is_judged_ends_the_start_too() -> None:
    run, outcome, _ = started("cia402", "supervisor.probe=0.05", torque=(-1.0, 1.0))
    assert "does not hold its pose: polarity of its drive, or of one before it" in outcome.reason
    assert not (run.cycle["state"] == State.RUN).any()


def test_a_joint_that_does_not_answer_is_named() -> None:
    stuck = '[{kind="lock", joint="joint2"}]'
    run, outcome, _ = started("cia402", "supervisor.probe=0.05", f"fault={stuck}")
    assert outcome.reason.startswith("joint2: no response to 5 Nm: stuck, or supervisor.probe")
    assert not (run.cycle["state"] == State.RUN).any()


def test_without_a_probe_nothing_is_pushed() -> None:
    run, outcome, _ = started("cia402")
    assert outcome.end_state == "done"
    assert np.count_nonzero(run.cycle["state"] == State.ARM) < 20
    assert signals.NAMES[signals.TAU_CMD] == "tau_cmd"
