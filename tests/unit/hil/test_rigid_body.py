"""The true robot against mechanics: closed forms, conserved quantities, brakes, motors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from dftc_rt.config.faults import Fault, LossFault
from dftc_rt.config.scenario import DriveTable, PlantTable
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.whole_body import WholeBody
from dftc_rt.errors import InputError
from hil.faults import compile_faults
from hil.plants.rigid_body import RigidBodyPlant

F64 = NDArray[np.float64]
PERIOD = 1e-3
STILL = DriveTable(torque_lag_s=0.0)


@pytest.fixture(scope="module")
def arm2() -> Robot:
    return load_robot("arm2")


@pytest.fixture(scope="module")
def panda() -> Robot:
    return load_robot("panda")


def plant_of(
    robot: Robot,
    q0: F64 | None = None,
    v0: F64 | None = None,
    *,
    drive: DriveTable = STILL,
    faults: tuple[Fault, ...] = (),
    closed: tuple[int, ...] = (),
    **table: Any,
) -> RigidBodyPlant:
    """A plant with its brakes open, but for some."""
    plant = RigidBodyPlant(
        robot,
        PlantTable(**table),
        drive,
        compile_faults(faults, robot.joints),
        PERIOD,
        robot.home if q0 is None else q0,
        np.zeros(robot.n) if v0 is None else v0,
    )
    released = np.ones(robot.n, dtype=bool)
    released[list(closed)] = False
    plant.set_brakes(released)
    return plant


def energy(robot: Robot, plant: RigidBodyPlant) -> float:
    data = robot.model.createData()
    x = robot.configuration(plant.q)
    kinetic = pin.computeKineticEnergy(robot.model, data, x, plant.v)
    return float(kinetic + pin.computePotentialEnergy(robot.model, data, x))


def pendulum_plant(arm2: Robot, q0: float, **table: Any) -> RigidBodyPlant:
    """Joint 2 of arm2 alone: 4 kg, centre of mass at 0.15 m, 0.1233 kg m² about the joint.

    With joint 1 braked at 0, M_22 = 0.1233 and G_2 = −5.88 sin q2: [zhao2017] eq. (35).
    """
    return plant_of(arm2, np.array([0.0, q0]), closed=(0,), **table)


# --- motion ------------------------------------------------------------------------------


def test_free_joint_under_constant_torque_near_the_bottom(arm2: Robot) -> None:
    # 0.1233 q'' = 5.88 sin(pi + x) + tau, small x: x = tau/5.88 (1 - cos(w t)).
    tau, omega = 0.01, np.sqrt(5.88 / 0.1233)
    plant = pendulum_plant(arm2, np.pi, substeps=100)
    plant.command[1] = tau
    for k in range(1, 501):
        plant.advance(100)
        expected = tau / 5.88 * (1 - np.cos(omega * k * PERIOD))
        assert plant.q[1] - np.pi == pytest.approx(expected, abs=2e-7)
    assert plant.t == pytest.approx(0.5)
    assert plant.q[0] == 0.0


def test_energy_is_conserved_and_the_error_is_of_first_order(panda: Robot) -> None:
    v0 = np.array([0.5, -0.4, 0.3, 0.6, -0.5, 0.4, 0.7])
    drift = []
    for substeps in (4, 8):
        plant = plant_of(panda, v0=v0, substeps=substeps)
        before = energy(panda, plant)
        worst = 0.0
        for _ in range(300):
            plant.advance(substeps)
            worst = max(worst, abs(energy(panda, plant) - before))
        assert np.abs(plant.q - panda.home).max() > 0.1  # it did move
        drift.append(worst)
    assert drift[0] < 0.05  # J, of some 10 J exchanged
    assert drift[1] == pytest.approx(drift[0] / 2, rel=0.1)


def test_substeps_divide_the_period(arm2: Robot) -> None:
    plant = plant_of(arm2, substeps=5)
    assert plant.dt == pytest.approx(PERIOD / 5)
    plant.advance(5)
    assert plant.t == pytest.approx(PERIOD)
    plant.advance(0)
    assert plant.t == pytest.approx(PERIOD)
    once, bit_by_bit = plant_of(arm2, substeps=5), plant_of(arm2, substeps=5)
    once.advance(10)
    for _ in range(10):
        bit_by_bit.advance(1)
    assert np.array_equal(once.q, bit_by_bit.q)
    assert np.array_equal(once.v, bit_by_bit.v)


def test_continuous_joints_turn_on_without_wrapping() -> None:
    robot = load_robot(urdf="kinova_description/robots/kinova.urdf")  # three such joints
    assert robot.model.nq > robot.model.nv
    i = int(np.flatnonzero(robot.continuous)[-1])
    v0 = np.zeros(robot.n)
    v0[i] = 20.0
    others = tuple(j for j in range(robot.n) if j != i)
    plant = plant_of(robot, v0=v0, closed=others)
    torque = WholeBody(robot)
    for _ in range(1000):
        plant.command[:] = torque.gravity(plant.q)
        plant.advance(4)
    turned = plant.q[i] - robot.home[i]
    assert turned > 2 * np.pi
    assert np.all(plant.q[list(others)] == robot.home[list(others)])


# --- brakes ------------------------------------------------------------------------------


def test_closed_brakes_hold_exactly(panda: Robot) -> None:
    plant = plant_of(panda, closed=tuple(range(7)))
    plant.command[:] = 50.0
    plant.advance(400)
    assert np.array_equal(plant.q, panda.home)
    assert not plant.v.any()
    assert plant.t == pytest.approx(0.1)


def test_one_closed_brake_constrains_the_rest(arm2: Robot) -> None:
    # Joint 2 held at 0.7: one rigid body about joint 1 with M_11 and G_1 of eq. (35).
    q2 = 0.7
    plant = plant_of(arm2, np.array([0.3, q2]), closed=(1,), substeps=100)
    plant.advance(1)
    M11 = 0.36 * np.cos(q2) + 0.6066
    G1 = -5.88 * np.sin(0.3 + q2) - 17.64 * np.sin(0.3)
    assert plant.v[0] == pytest.approx(-G1 / M11 * plant.dt, rel=1e-9)
    plant.advance(9999)
    assert plant.q[1] == q2
    assert plant.v[1] == 0.0
    assert abs(plant.q[0] - 0.3) > 0.01


def test_closing_brake_takes_momentum_through_the_constraint_only(panda: Robot) -> None:
    v0 = np.array([0.5, -0.4, 0.3, 0.6, -0.5, 0.4, 0.7])
    plant = plant_of(panda, v0=v0)
    before = energy(panda, plant)
    M = WholeBody(panda).mass_matrix(plant.q)
    held = [1, 4]
    free = [0, 2, 3, 5, 6]
    released = np.ones(7, dtype=bool)
    released[held] = False
    plant.set_brakes(released)
    assert not plant.v[held].any()
    momentum = M @ plant.v - M @ v0  # the impulse acts on the braked joints alone
    assert np.abs(momentum[free]).max() < 1e-12
    assert np.abs(momentum[held]).max() > 1e-3
    assert energy(panda, plant) < before
    assert np.abs(plant.v[free] - v0[free]).max() > 1e-3


def test_initial_velocity_waits_for_the_brake(arm2: Robot) -> None:
    plant = plant_of(arm2, v0=np.array([0.2, -0.1]), closed=(0, 1))
    assert not plant.v.any()
    plant.set_brakes(np.array([True, True]))
    assert plant.v.tolist() == [0.2, -0.1]
    plant.set_brakes(np.array([False, True]))
    plant.set_brakes(np.array([True, True]))
    assert plant.v[0] == 0.0  # once only


def test_brake_takes_the_motors_torque(arm2: Robot) -> None:
    plant = plant_of(arm2)
    plant.command[:] = 3.0
    plant.advance(4)
    assert plant.motor.tolist() == [3.0, 3.0]
    plant.set_brakes(np.array([True, False]))
    plant.advance(4)
    assert plant.motor.tolist() == [3.0, 0.0]
    assert plant.applied.tolist() == [3.0, 0.0]


# --- motors ------------------------------------------------------------------------------


def test_motor_torque_knows_nothing_of_the_loss(arm2: Robot) -> None:
    fault = LossFault(joint="joint1", start_s=0.002, effectiveness=0.25)
    plant = plant_of(arm2, faults=(fault,))
    plant.command[:] = [8.0, 2.0]
    plant.advance(8)
    assert plant.applied.tolist() == [8.0, 2.0]
    plant.advance(4)
    assert plant.motor.tolist() == [8.0, 2.0]
    assert plant.applied.tolist() == [2.0, 2.0]
    assert plant.rho.tolist() == [0.25, 1.0]
    assert plant.fault.tolist() == [1.0, 0.0]


def test_applied_torque_is_what_moves_the_links(arm2: Robot) -> None:
    fault = LossFault(joint="joint2", effectiveness=0.5)
    faulty = plant_of(arm2, faults=(fault,))
    healthy = plant_of(arm2)
    faulty.command[:] = [0.0, 2.0]
    healthy.command[:] = [0.0, 1.0]
    faulty.advance(40)
    healthy.advance(40)
    np.testing.assert_allclose(faulty.q, healthy.q, rtol=0, atol=1e-15)


def test_lag_has_its_time_constant(arm2: Robot) -> None:
    lag = 0.005
    plant = plant_of(arm2, drive=DriveTable(torque_lag_s=lag))
    plant.command[:] = 1.0
    for k in range(1, 21):
        plant.advance(4)
        assert plant.motor[0] == pytest.approx(1 - np.exp(-k * PERIOD / lag), abs=1e-12)


# --- what the controller is not told -------------------------------------------------------


def test_payload_and_armature_are_the_plants_alone(panda: Robot) -> None:
    believed = panda.armature.copy()
    masses = [inertia.mass for inertia in panda.model.inertias]
    plain = plant_of(panda)
    loaded = plant_of(panda, payload_kg=2.0, armature=0.5)
    plain.advance(4)
    loaded.advance(4)
    assert np.abs(plain.v - loaded.v).max() > 1e-3
    assert np.array_equal(panda.armature, believed)
    assert [inertia.mass for inertia in panda.model.inertias] == masses


def test_armature_adds_to_the_inertia(arm2: Robot) -> None:
    plant = pendulum_plant(arm2, np.pi / 2, substeps=1, armature=0.1)
    plant.advance(1)
    assert plant.v[1] == pytest.approx(5.88 / (0.1233 + 0.1) * PERIOD, rel=1e-9)
    assert plant.q[1] - np.pi / 2 == pytest.approx(plant.v[1] * PERIOD, rel=1e-6)  # semi-implicit


@pytest.mark.parametrize("table", [{"viscous": 0.3}, {"coulomb": 0.4}])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_opposes_motion(arm2: Robot, table: dict[str, float], sign: float) -> None:
    v0 = np.array([0.0, 0.5 * sign])
    rough = plant_of(arm2, np.array([0.0, np.pi]), v0, closed=(0,), substeps=1, **table)
    smooth = plant_of(arm2, np.array([0.0, np.pi]), v0, closed=(0,), substeps=1)
    rough.advance(1)
    smooth.advance(1)
    loss = (rough.v[1] - smooth.v[1]) * 0.1233 / PERIOD
    torque = 0.3 * 0.5 if "viscous" in table else 0.4
    assert loss == pytest.approx(-sign * torque, rel=1e-6)


def test_wrong_number_of_values_is_refused(arm2: Robot) -> None:
    with pytest.raises(InputError, match=r"rig\.plant\.viscous: 3 values"):
        plant_of(arm2, viscous=(1.0, 2.0, 3.0))
