"""The floors measure what they claim to."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.whole_body import WholeBody
from dftc_rt.errors import EnvironmentLacksError
from tests.benchmarks import cyclictest, mujoco_floor

# Laid out as cyclictest 2.4 prints it; 100 wake-ups, one of them beyond the histogram.
HISTOGRAM = """\
# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000012 000049
000013 000001
000040 000048
000090 000001
# Total: 000000099
# Min Latencies: 00012
# Avg Latencies: 00025
# Max Latencies: 19975
# Histogram Overflows: 00001
# Histogram Overflow at cycle number:
# Thread 0: 00077
"""


def test_percentiles_of_a_histogram() -> None:
    found = cyclictest.parse(HISTOGRAM)
    assert found == cyclictest.Lateness(p50_us=13, p99_us=90, max_us=19975, samples=100, late=1)


def test_overflows_count_as_the_maximum() -> None:
    found = cyclictest.parse(HISTOGRAM.replace("Overflows: 00001", "Overflows: 00003"))
    assert (found.p99_us, found.samples, found.late) == (19975, 102, 3)


@pytest.mark.parametrize(
    "text", ["", "# Max Latencies: 00001\n", HISTOGRAM.replace("# Max Latencies", "# Biggest")]
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="no histogram"):
        cyclictest.parse(text)


def test_missing_program_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(EnvironmentLacksError, match="rt-tests"):
        cyclictest.measure(core=0, seconds=1)


@pytest.mark.parametrize("name", ["arm2", "panda", "ur5", "xarm7"])
def test_mujoco_model_is_the_same_robot(name: str) -> None:
    robot = load_robot(name)
    model = mujoco_floor.compile_model(robot.urdf_xml, robot.locked)
    order = [robot.joints.index(model.joint(i).name) for i in range(model.njnt)]
    rng = np.random.default_rng(3)
    q, v = rng.uniform(-1, 1, robot.n), rng.uniform(-1, 1, robot.n)
    data = mujoco.MjData(model)
    model.opt.gravity[:] = robot.gravity
    data.qpos[:], data.qvel[:] = q[order], v[order]
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    body = WholeBody(robot)
    assert sorted(order) == list(range(robot.n))
    expected = body.mass_matrix(q) - np.diag(robot.armature)
    np.testing.assert_allclose(mass, expected[np.ix_(order, order)], rtol=1e-6, atol=1e-9)
    bias = body.inverse_dynamics(q, v, np.zeros(robot.n))
    np.testing.assert_allclose(data.qfrc_bias, bias[order], rtol=1e-6, atol=1e-7)


def test_welding_an_unknown_joint_is_refused() -> None:
    robot = load_robot("arm2")
    with pytest.raises(ValueError, match="no joint nowhere"):
        mujoco_floor.strip(robot.urdf_xml, {"nowhere": 0.0})


def test_welded_joint_stays_where_it_was_put() -> None:
    robot = load_robot("panda", lock=["panda_joint4"], lock_rad=[-1.3])
    model = mujoco_floor.compile_model(robot.urdf_xml, robot.locked)
    assert model.nv == robot.n == 6
    q = np.linspace(-0.5, 0.5, 6)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    gravity = WholeBody(robot).gravity(q)
    np.testing.assert_allclose(data.qfrc_bias, gravity, rtol=1e-6, atol=1e-7)


def test_one_cycle_is_its_steps() -> None:
    robot = load_robot("panda")
    model = mujoco_floor.compile_model(robot.urdf_xml, robot.locked)
    floor = mujoco_floor.measure(model, robot.home, substeps=4, cycles=100)
    assert floor.joints == 7
    assert 0 < floor.step_us == pytest.approx(floor.cycle_us / 4)
