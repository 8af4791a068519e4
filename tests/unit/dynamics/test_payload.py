import numpy as np
import pinocchio as pin
import pytest

from dftc_rt.dynamics.payload import with_armature, with_payload
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.errors import InputError


def test_a_mass_at_the_tip_of_arm2_by_hand():
    robot = load_robot("arm2")
    q = np.array([0.4, 0.3])
    model = with_payload(robot, 0.5, [0.0, 0.0, 0.3])
    before = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), q)
    after = pin.computeGeneralizedGravity(model, model.createData(), q)
    outer = -0.5 * 9.8 * 0.3 * np.sin(0.7)
    inner = -0.5 * 9.8 * 0.3 * np.sin(0.4)
    np.testing.assert_allclose(after - before, [outer + inner, outer], atol=1e-12)
    M = pin.crba(model, model.createData(), q)
    assert M[1, 1] == pytest.approx(0.1233 + 0.5 * 0.09, abs=1e-12)


def test_on_another_link():
    robot = load_robot("arm2")
    q = np.array([0.4, 0.3])
    model = with_payload(robot, 0.5, [0.0, 0.0, 0.3], joint="joint1")
    assert pin.crba(model, model.createData(), q)[1, 1] == pytest.approx(0.1233, abs=1e-12)


@pytest.mark.parametrize("mass", [-1.0, float("inf"), float("nan")])
def test_no_mass(mass):
    with pytest.raises(InputError, match="payload_kg"):
        with_payload(load_robot("arm2"), mass, [0, 0, 0])


def test_no_point_and_no_joint():
    with pytest.raises(InputError, match="payload_com_m"):
        with_payload(load_robot("arm2"), 1.0, [0, 0])
    with pytest.raises(InputError, match="is no joint of the robot"):
        with_payload(load_robot("arm2"), 1.0, [0, 0, 0], joint="x")


def test_armature_adds_to_the_diagonal_of_a_copy():
    robot = load_robot("arm2")
    q = np.array([0.4, 0.3])
    M = pin.crba(robot.model, robot.model.createData(), q)
    for source, values in ((robot, 0.1), (robot.model, [0.1, 0.2])):
        model = with_armature(source, values)
        grown = pin.crba(model, model.createData(), q)
        np.testing.assert_allclose(grown - M, np.diag(np.broadcast_to(values, 2)), atol=1e-12)
    assert robot.armature.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("values", [-0.1, [0.1], [0.1, float("nan")]])
def test_no_armature(values):
    with pytest.raises(InputError, match="expected a number or 2 of them, 0 or more"):
        with_armature(load_robot("arm2"), values)
