"""What a motor gives of what it is told, kind by kind, by hand; and what the truth calls it."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.config.faults import (
    BiasFault,
    ContactFault,
    DeadZoneFault,
    Fault,
    FrictionFault,
    LagFault,
    LossFault,
    PayloadFault,
    SaturationFault,
    StuckTorqueFault,
)
from dftc_rt.dynamics.robot import load_robot
from hil.plants.rigid_body import RigidBodyPlant
from tests.unit.hil.test_rigid_body import PERIOD, plant_of

ARM2 = load_robot("arm2")  # torque limits of 200 and 100 Nm


def told(plant: RigidBodyPlant, torque: float) -> tuple[float, float]:
    """Tell joint 2's motor ``torque`` for a period: what it gives, and its effectiveness."""
    plant.command[1] = torque
    plant.advance(4)
    plant.reveal()
    assert plant.motor[1] == torque  # its current knows nothing
    assert plant.applied[0] == plant.command[0]
    assert plant.rho[0] == 1.0
    return float(plant.applied[1]), float(plant.rho[1])


@pytest.mark.parametrize(
    ("fault", "cases"),
    [
        (BiasFault(joint="joint2", torque_nm=-1.5), {8.0: (6.5, 1.0), 0.0: (-1.5, 1.0)}),
        (SaturationFault(joint="joint2", limit=0.1),
         {20.0: (10.0, 0.5), -40.0: (-10.0, 0.25), 4.0: (4.0, 1.0), 0.0: (0.0, 1.0)}),
        (SaturationFault(joint="joint2", limit=0.0), {20.0: (0.0, 0.0)}),
        (DeadZoneFault(joint="joint2", width_nm=2.0),
         {5.0: (3.0, 0.6), -5.0: (-3.0, 0.6), 1.0: (0.0, 0.0), 0.0: (0.0, 0.0)}),
    ],
)  # fmt: skip
def test_torque_and_effectiveness(fault: Fault, cases: dict[float, tuple[float, float]]) -> None:
    plant = plant_of(ARM2, faults=(fault,))
    for torque, (given, rho) in cases.items():
        assert told(plant, torque) == pytest.approx((given, rho))
        assert plant.fault.tolist() == [0.0, 1.0]


def test_a_stuck_motor_holds_what_it_gave_from_start_to_end() -> None:
    faults = (
        StuckTorqueFault(joint="joint2", start_s=0.003, end_s=0.006),
        StuckTorqueFault(joint="joint2", start_s=0.007),
        LossFault(joint="joint2", effectiveness=0.5),
    )
    plant = plant_of(ARM2, faults=faults)
    assert told(plant, 9.0) == (4.5, 0.5)
    assert told(plant, 9.0) == (4.5, 0.5)
    plant.command[1] = 10.0
    plant.advance(4)
    assert plant.applied[1] == 5.0
    for torque in (-7.0, 0.0, 3.0):
        plant.command[1] = torque
        plant.advance(4)
        assert plant.applied[1] == 5.0
        assert plant.rho[1] == 0.0
    plant.command[1] = -7.0
    plant.advance(4)
    assert plant.applied[1] == -3.5
    assert plant.rho[1] == 0.5
    assert told(plant, 8.0) == (-3.5, 0.0)  # stuck again, elsewhere


def test_a_further_lag_has_its_time_constant_and_does_not_show_in_the_current() -> None:
    plant = plant_of(ARM2, faults=(LagFault(joint="joint2", lag_s=0.004, start_s=0.002),))
    assert told(plant, 2.0) == (2.0, 1.0)
    assert told(plant, 2.0) == (2.0, 1.0)
    for k in range(1, 30):
        given, rho = told(plant, 3.0)
        assert given == pytest.approx(3.0 - np.exp(-k * PERIOD / 0.004), abs=1e-12)
        assert rho == 1.0


def test_order_is_constant_dead_zone_share_bias() -> None:
    faults = (
        BiasFault(joint="joint2", torque_nm=1.0),
        BiasFault(joint="joint2", torque_nm=-0.25),
        LossFault(joint="joint2", effectiveness=0.5),
        SaturationFault(joint="joint2", limit=0.06),
        SaturationFault(joint="joint2", limit=0.9),
        DeadZoneFault(joint="joint2", width_nm=2.0),
        DeadZoneFault(joint="joint2", width_nm=1.0),
    )
    plant = plant_of(ARM2, faults=faults, torque_constant=(1.0, 0.9))
    given, rho = told(plant, 10.0)
    assert given == pytest.approx(min(9.0 - 2.0, 6.0) * 0.5 + 0.75)
    assert rho == pytest.approx(6.0 / 9.0 * 0.5)


def test_a_wrong_torque_constant_is_no_fault() -> None:
    plant = plant_of(ARM2, torque_constant=(1.0, 1.1))
    assert told(plant, 10.0) == (pytest.approx(11.0), 1.0)
    assert not plant.fault.any()


@pytest.mark.parametrize("closed", [(0, 1), (1,)])
def test_a_closed_brake_holds_whatever_the_fault(closed: tuple[int, ...]) -> None:
    plant = plant_of(
        ARM2, np.array([0.3, 0.7]), closed=closed, friction="lugre", coulomb=2.0,
        faults=(
            BiasFault(joint="joint2", torque_nm=30.0),
            StuckTorqueFault(joint="joint2", start_s=0.04),
            LagFault(joint="joint2", lag_s=0.01), PayloadFault(payload_kg=3.0, start_s=0.02),
            ContactFault(force_n=(50.0, 0.0, 0.0)), FrictionFault(factor=0.0, start_s=0.03),
        ),
    )  # fmt: skip
    for _ in range(60):
        plant.advance(4)
        assert plant.q[1] == 0.7
        assert plant.v[1] == 0.0
        assert plant.motor[1] == 0.0
        assert plant.applied[1] == 0.0
    assert (plant.q[0] == 0.3) == (0 in closed)


def test_a_motor_that_got_stuck_under_its_brake_gives_nothing_after() -> None:
    fault = StuckTorqueFault(joint="joint2", start_s=0.002)
    plant = plant_of(ARM2, closed=(1,), faults=(fault,))
    plant.advance(20)
    plant.set_brakes(np.array([True, True]))
    assert told(plant, 8.0) == (0.0, 0.0)
