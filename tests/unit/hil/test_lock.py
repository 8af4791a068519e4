"""A joint that a fault blocks, while its drive goes on as if nothing were."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.config.faults import LockFault
from dftc_rt.config.scenario import DriveTable, PlantTable
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.robot import load_robot
from hil.faults import compile_faults
from hil.plants.rigid_body import RigidBodyPlant


@pytest.fixture(scope="module")
def arm2() -> Robot:
    return load_robot("arm2")


def plant_of(
    robot: Robot, *faults: LockFault, v0: tuple[float, float] = (0.0, 0.0)
) -> RigidBodyPlant:
    """A plant at 1 kHz, brakes open, no lag."""
    plant = RigidBodyPlant(
        robot,
        PlantTable(),
        DriveTable(torque_lag_s=0.0),
        compile_faults(faults, robot.joints),
        1e-3,
        robot.home,
        np.array(v0),
    )
    plant.set_brakes(np.ones(2, dtype=bool))
    return plant


def test_it_stands_exactly_from_start_to_end_and_the_rest_moves(arm2: Robot) -> None:
    plant = plant_of(arm2, LockFault(joint="joint2", start_s=0.1, end_s=0.2), v0=(0.3, -0.4))
    plant.advance(400)
    stood, q1 = plant.q[1], plant.q[0]
    assert plant.v[1] != 0.0
    plant.advance(399)
    assert plant.q[1] == stood
    assert plant.v[1] == 0.0
    assert plant.q[0] != q1
    plant.advance(1)
    plant.advance(4)
    assert plant.q[1] != stood


def test_stopping_it_is_an_impulse_at_that_joint_alone(arm2: Robot) -> None:
    locked = plant_of(arm2, LockFault(joint="joint2"), v0=(0.3, -0.4))
    braked = plant_of(arm2, v0=(0.3, -0.4))
    braked.set_brakes(np.array([True, False]))
    locked.advance(4)
    braked.advance(4)
    np.testing.assert_array_equal(locked.q, braked.q)
    np.testing.assert_array_equal(locked.v, braked.v)
    assert locked.v[0] != 0.3


def test_the_motor_pushes_on_and_nothing_of_it_arrives(arm2: Robot) -> None:
    plant = plant_of(arm2, LockFault(joint="joint2"))
    plant.command[:] = 3.0
    plant.advance(4)
    plant.reveal()
    assert plant.motor.tolist() == [3.0, 3.0]  # what the drive reports: its current
    assert plant.applied.tolist() == [3.0, 0.0]
    assert plant.rho.tolist() == [1.0, 0.0]
    assert plant.fault.tolist() == [0.0, 1.0]
    assert plant.released.all()


def test_a_brake_that_closes_and_opens_meanwhile_does_not_free_it(arm2: Robot) -> None:
    plant = plant_of(arm2, LockFault(joint="joint2"))
    plant.advance(4)
    stood = plant.q[1]
    plant.set_brakes(np.array([True, False]))
    plant.set_brakes(np.array([True, True]))
    plant.advance(40)
    assert plant.q[1] == stood


def test_every_joint_locked_is_an_arm_that_stands(arm2: Robot) -> None:
    plant = plant_of(arm2, LockFault(joint="joint1"), LockFault(joint="joint2"), v0=(0.3, -0.4))
    plant.command[:] = 3.0
    plant.advance(40)
    assert plant.q.tolist() == arm2.home.tolist()
    assert plant.applied.tolist() == [0.0, 0.0]
