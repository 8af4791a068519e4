"""However a run ends, no drive stays enabled."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dftc_rt.cli import simulate
from dftc_rt.cli.session import open_session
from dftc_rt.control import signals
from dftc_rt.errors import InputError
from hil.simulate import InProcessRig, in_process_rig


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[InProcessRig]:
    """The rigs that are made during the test."""
    rigs: list[InProcessRig] = []

    def remember(*args: Any) -> InProcessRig:
        rigs.append(in_process_rig(*args))
        return rigs[-1]

    monkeypatch.setattr(simulate, "in_process_rig", remember)
    return rigs


def test_a_law_that_raises(made: list[InProcessRig], monkeypatch: pytest.MonkeyPatch) -> None:
    opened = open_session("panda_shoulder_loss", ["duration_s=1"])
    law = opened.parts.law
    update, calls = law.update, [0]

    def fail(rec: Any, inertia: Any, bias: Any, load: Any) -> int:
        calls[0] += 1
        if calls[0] == 300:
            assert made[0].rig.drives.operation_enabled.all()
            raise FloatingPointError("a law of one's own")
        return update(rec, inertia, bias, load)

    monkeypatch.setattr(law, "update", fail)
    run, outcome = simulate.run_simulation(opened)
    assert (outcome.end_state, outcome.reason) == (
        "safe stop", "the law raised FloatingPointError: a law of one's own",
    )  # fmt: skip
    assert calls[0] == 300  # and it is not asked again
    assert run.rig is not None
    at = int(np.flatnonzero(run.cycle["state"] == 6)[0])  # the first cycle after it
    assert np.any(run.rig["v"][at - 1] != 0.0)
    assert not run.rig["tau_applied"][at + 1 :].any()
    assert not run.rig["v"][at + 1 :].any()
    assert not made[0].rig.drives.operation_enabled.any()
    assert not made[0].rig.drives.command.any()


def test_a_start_from_which_the_blend_would_be_too_fast_is_refused(
    made: list[InProcessRig],
) -> None:
    far = "rig.plant.q0_rad=[2.5, -1.5, 2.5, -2.9, 2.5, 3.0, 2.5]"
    opened = open_session("panda_shoulder_loss", ["duration_s=2", far])
    with pytest.raises(InputError, match="rad/s"):
        simulate.run_simulation(opened)
    assert not made[0].rig.drives.operation_enabled.any()


def test_a_pose_beyond_the_joint_limits_is_refused_in_one_line(made: list[InProcessRig]) -> None:
    beyond = "rig.plant.q0_rad=[0.0, -0.5, 0.0, 0.1, 0.0, 1.6, 0.7]"  # joint 4 ends at -0.07
    opened = open_session("panda_shoulder_loss", ["duration_s=2", beyond])
    with pytest.raises(InputError) as refused:
        simulate.run_simulation(opened)
    assert "\n" not in str(refused.value)
    assert "panda_joint4 (node 4 on can1): is at 0.100 rad" in str(refused.value)
    assert refused.value.exit_code == 2
    assert not made[0].rig.drives.operation_enabled.any()


def test_drives_that_lose_the_controller_afterwards_report_no_fault(
    made: list[InProcessRig],
) -> None:
    _, outcome = simulate.run_simulation(open_session("panda_shoulder_loss", ["duration_s=0.2"]))
    assert outcome.end_state == "done"
    rig = made[0].rig
    rig.drives.tick(rig.t + 1.0)
    out = np.zeros((512, 16), dtype=np.uint8)
    emergencies = 0
    for bus in range(3):
        count = rig.drives.answer(bus, out)
        identifiers = out[:count].view("<u4")[:, 0] & 0x7FF
        emergencies += int(np.count_nonzero((identifiers > 0x080) & (identifiers < 0x100)))
    assert emergencies == 0


def test_an_unreachable_limit_ramps_down_and_a_lost_actuator_is_braked() -> None:
    ramped, outcome = simulate.run_simulation(
        open_session("panda_shoulder_loss", ["supervisor.tracking_error_rad=0.004"])
    )
    assert outcome.reason == "panda_joint2: tracking error over 0.004 rad"
    assert np.count_nonzero(ramped.cycle["state"] == 5) == 300
    total = 'fault=[{joint="panda_joint2", kind="total", start_s=2.0}]'
    braked, outcome = simulate.run_simulation(open_session("panda_shoulder_loss", [total]))
    assert outcome.reason == "panda_joint2: estimated effectiveness below 0.15"
    assert np.count_nonzero(braked.cycle["state"] == 5) == 0
    assert braked.rig is not None
    np.testing.assert_array_equal(braked.rig["v"][-1], 0.0)
    assert (braked.cycle["verdict"][:, 1] == signals.ACTUATOR_LOSS).any()
