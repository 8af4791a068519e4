"""The regression on motion and torque that were made from known parameters."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dftc_rt.calibration import physical
from dftc_rt.calibration.regression import FRICTION, Fit, fit
from dftc_rt.calibration.signals import Motion, delivered, motion
from dftc_rt.dynamics.payload import with_payload
from dftc_rt.dynamics.regressor import (
    inertial_parameters,
    last_joints,
    pseudo_inertia,
    rows,
    with_inertial_parameters,
)
from dftc_rt.dynamics.robot import Robot, load_robot
from dftc_rt.errors import InputError

H = 1e-3
TRUE = {
    "viscous": np.array([1.5, 1.2, 0.8, 0.3, 0.2, 0.1]),
    "coulomb": np.array([3.0, 2.0, 2.5, 0.5, 0.4, 0.3]),
    "offset": np.array([0.5, -0.4, 0.2, 0.1, 0.0, -0.05]),
    "torque_constant": np.array([1.04, 0.97, 1.0, 1.02, 0.95, 1.0]),
}


def _multisine(robot: Robot, seconds: float, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / H)) * H
    omega = 2 * np.pi * rng.uniform(0.1, 0.6, (5, robot.n))
    phase = rng.uniform(0, 2 * np.pi, (5, robot.n))
    arg = omega * t[:, None, None] + phase
    q = robot.home + 0.15 * np.sin(arg).sum(1)
    return q, 0.15 * (omega * np.cos(arg)).sum(1), -0.15 * (omega**2 * np.sin(arg)).sum(1)


def _loaded(robot: Robot, mass: float = 1.0, armature: float = 0.02) -> Robot:
    model = with_payload(robot, mass, (0.02, 0.0, 0.1))
    model.armature = np.array(robot.armature) + armature
    return dataclasses.replace(robot, model=model)


def _motion(robot: Robot, noise: float = 0.0, seconds: float = 30.0, seed: int = 3) -> Motion:
    """Filtered signals of a loaded robot with friction and wrong torque constants."""
    q, v, a = _multisine(robot, seconds, seed)
    true = _loaded(robot)
    data = true.model.createData()
    torque = np.array([pin.rnea(true.model, data, *each) for each in zip(q, v, a, strict=True)])
    torque += TRUE["viscous"] * v + TRUE["coulomb"] * np.tanh(v / 0.01) + TRUE["offset"]
    told = torque / TRUE["torque_constant"]
    rng = np.random.default_rng(1)
    return motion(q, v + rng.normal(0, noise, v.shape), told, H, 0.0)


@pytest.fixture(scope="module")
def ur5() -> Robot:
    return load_robot("ur5")


@pytest.fixture(scope="module")
def found(ur5: Robot) -> Fit:
    return fit(ur5, [_motion(ur5, noise=0.002)], ur5.torque_limit)


@pytest.mark.parametrize("name", [name for name in FRICTION if name != "armature"])
def test_friction_and_torque_constants_are_recovered(name: str, found: Fit) -> None:
    off = np.abs(found.values[name] - TRUE[name])
    scale = np.maximum(np.abs(TRUE[name]), 0.1)
    assert np.all(off < 5.0 * found.std[name] + 0.01 * scale), (name, found.values[name])
    assert np.all(found.std[name] < 0.3 * scale), (name, found.std[name])


def test_load_and_armature_are_recovered(ur5: Robot, found: Fit) -> None:
    nominal = inertial_parameters(ur5)[0]
    assert found.load[0, 0] - nominal[0] == pytest.approx(1.0, abs=0.03)
    assert found.load[0, 0] - nominal[0] == pytest.approx(1.0, abs=5 * found.load_std[0, 0])
    moment = found.load[0, 1:4] - nominal[1:4]
    np.testing.assert_allclose(moment, [0.02, 0.0, 0.1], atol=0.01)
    off = np.abs(found.values["armature"] - ur5.armature - 0.02)
    assert np.all(off < 5.0 * found.std["armature"] + 0.005)
    assert found.not_excited[1] == ()


def test_a_joint_that_stands_still_is_named(ur5: Robot) -> None:
    full = _motion(ur5)
    still = {"v": full.v.copy(), "a": full.a.copy(), "sign": full.sign.copy()}
    for values in still.values():
        values[:, 0] = 0.0
    q = full.q.copy()
    q[:, 0] = ur5.home[0]
    fixed = dataclasses.replace(full, q=q, **still)
    found = fit(ur5, [fixed], ur5.torque_limit)
    assert {"viscous", "coulomb", "armature"} <= set(found.not_excited[0])
    assert found.values["coulomb"][0] == pytest.approx(0.0, abs=1e-6)
    assert "coulomb" not in found.not_excited[2]


def test_no_run_and_no_motion_are_refused(ur5: Robot) -> None:
    with pytest.raises(InputError, match="no run"):
        fit(ur5, [], ur5.torque_limit)
    full = _motion(ur5, seconds=4.0)
    still = dataclasses.replace(full, v=0 * full.v)
    with pytest.raises(InputError, match="stands still"):
        fit(ur5, [still], ur5.torque_limit)
    with pytest.raises(InputError, match="more than"):
        _motion(ur5, seconds=1.0)


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_regressor_is_the_derivative_of_the_torque(name: str) -> None:
    robot = load_robot(name)
    rng = np.random.default_rng(5)
    q, v, a = robot.home + rng.normal(0, 0.3, (3, robot.n)), *rng.normal(0, 1, (2, 3, robot.n))
    torque, regressor = rows(robot, q, v, a)
    assert regressor.shape == (3, robot.n, 10)
    change = np.array([0.5, 0.02, -0.01, 0.05, 0.01, 0.001, 0.02, -0.002, 0.003, 0.015])
    parameters = inertial_parameters(robot) + change
    other = dataclasses.replace(robot, model=with_inertial_parameters(robot, parameters))
    np.testing.assert_allclose(rows(other, q, v, a)[0], torque + regressor @ change, atol=1e-10)


def test_the_last_link_is_the_one_without_a_child() -> None:
    robot = load_robot("panda")
    assert last_joints(robot) == (robot.n - 1,)
    assert last_joints(load_robot("pendulums")) == ()  # a closed form


def test_an_impossible_link_is_moved_to_the_nearest_possible_one(ur5: Robot) -> None:
    nominal = inertial_parameters(ur5)
    wanted = nominal[0].copy()
    wanted[4] = -0.05  # a negative moment of inertia
    assert not physical.is_physical(wanted)
    x = np.concatenate([wanted - nominal[0], [0.7]])
    normal = np.eye(11)
    normal[0, 10] = normal[10, 0] = 0.5  # the free entry follows the mass
    moved = physical.nearest(x, normal, nominal)
    link = nominal[0] + moved[:10]
    assert np.linalg.eigvalsh(pseudo_inertia(link))[0] > -1e-12
    assert np.linalg.norm(link - wanted) < 0.15
    assert moved[10] == pytest.approx(0.7 - 0.5 * (moved[0] - x[0]))
    same = np.zeros(11)
    assert physical.nearest(same, normal, nominal) is same


def test_delivered_torque_waits_for_sync_and_lags() -> None:
    command = np.zeros((6, 2))
    command[1:, 0] = 1.0
    command[1:, 1] = 1.0
    out = delivered(command, H, np.array([0, 1]), np.array([0.0, 0.0]))
    # Sent in cycle 1, in force from SYNC 1 + delay: it shows in the mean of the period after.
    np.testing.assert_array_equal(out[:, 0], [0, 0, 1, 1, 1, 1])
    np.testing.assert_array_equal(out[:, 1], [0, 0, 0, 1, 1, 1])
    lagged = delivered(command, H, np.array([0, 0]), np.array([1e-3, 0.0]))
    assert lagged[2, 0] == pytest.approx(np.exp(-1.0))  # mean of 1 - exp(-t/T) over one T
