"""The true robot as a closed form: motion, brakes, friction, and what it has no place for."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.config.faults import FrictionFault
from dftc_rt.config.load import load_scenario
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.errors import InputError
from hil import SCENARIOS
from hil.rig import check_rig
from tests.unit.hil.test_rigid_body import PERIOD, RigidBodyPlant, plant_of

URDF = load_robot("arm2")
CLOSED = load_robot(plant="arm2")
PENDULUMS = load_robot("pendulums")
Q0, V0 = np.array([0.3, -0.8]), np.array([1.0, -2.0])


def test_pendulum_falls_as_the_printed_state_form_says() -> None:
    q0 = np.array([0.4, 0.4])  # the spring is as long as at rest
    plant = plant_of(PENDULUMS, q0, substeps=1)
    plant.command[:] = [0.5, -0.25]
    plant.advance(1)
    expected = (5.88 * np.sin(0.4) + np.array([0.5, -0.25])) * PERIOD
    np.testing.assert_allclose(plant.v, expected, rtol=1e-12)


def test_pendulum_beside_a_braked_one_keeps_its_damping_and_its_spring() -> None:
    q0, v0 = np.array([0.0, np.pi / 2]), np.array([2.0, 0.0])
    plant = plant_of(PENDULUMS, q0, v0, closed=(1,), substeps=1)
    plant.advance(1)
    # Ends of the spring at (0, 0.1) and (1.1, 0): it pulls to the right and down.
    stretch = np.sqrt(1.22) - 1.0
    tension = 30.0 * (1.0 + 0.01 * stretch**2) * stretch
    expected = 4.0 * tension * 0.1 * 1.1 / np.sqrt(1.22) - 0.036 * 2.0
    assert (plant.v[0] - 2.0) / PERIOD == pytest.approx(expected, rel=1e-9)
    assert plant.q[1] == np.pi / 2
    assert plant.v[1] == 0.0


@pytest.mark.parametrize("closed", [(), (0,), (1,), (0, 1)])
@pytest.mark.parametrize("friction", [{}, {"viscous": 0.3, "coulomb": (0.4, 0.1)}])
def test_arm_moves_as_its_urdf_brakes_and_friction_included(
    closed: tuple[int, ...], friction: dict[str, float]
) -> None:
    plants = [plant_of(r, Q0, V0, closed=closed, **friction) for r in (URDF, CLOSED)]
    for plant in plants:
        plant.command[:] = [2.0, -1.0]
        plant.advance(1200)
    for row in ("q", "v", "applied"):
        one, other = (getattr(plant, row) for plant in plants)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-10)
    moved = np.abs(plants[1].q - Q0) > 0.01
    assert moved.tolist() == [i not in closed for i in range(2)]


def test_closing_brake_acts_as_on_the_urdf() -> None:
    velocities = []
    for robot in (URDF, CLOSED):
        plant = plant_of(robot, Q0, V0)
        plant.set_brakes(np.array([True, False]))
        velocities.append(plant.v.copy())
    np.testing.assert_allclose(velocities[0], velocities[1], rtol=0, atol=1e-12)
    assert velocities[1][1] == 0.0
    assert abs(velocities[1][0] - V0[0]) > 1e-3  # the rest took its share


def test_friction_acts_on_the_pendulums_too() -> None:
    def slowed(**friction: float) -> float:
        plant: RigidBodyPlant = plant_of(PENDULUMS, np.zeros(2), V0, substeps=1, **friction)
        plant.advance(1)
        return float(plant.v[0])

    smooth = slowed()
    assert (smooth - slowed(viscous=0.3)) / PERIOD == pytest.approx(0.3 * V0[0], rel=1e-9)
    assert (smooth - slowed(coulomb=0.2)) / PERIOD == pytest.approx(0.2, rel=1e-6)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("rig.plant.payload_kg=1.5",
         "rig.plant.payload_kg: found 1.5 with the closed-form plant 'arm2' (expected 0)"),
        ("rig.plant.armature=0.1",
         "rig.plant.armature: found 0.1 with the closed-form plant 'arm2' (expected 0)"),
        ("rig.plant.armature=[0.0, 0.2]", "rig.plant.armature: found (0.0, 0.2)"),
    ],
)  # fmt: skip
def test_payload_and_armature_are_refused(setting: str, message: str) -> None:
    scenario = load_scenario("paper_example2", [setting], SCENARIOS).scenario
    with pytest.raises(InputError) as caught:
        check_rig(scenario, CLOSED)
    assert message in str(caught.value)
    check_rig(scenario, URDF)  # which can have both
    table = scenario.rig.plant
    with pytest.raises(InputError, match="closed-form plant 'arm2'"):
        plant_of(CLOSED, payload_kg=table.payload_kg, armature=table.armature)


@pytest.mark.parametrize(
    ("kind", "keys"), [("payload", "payload_kg=1.0"), ("contact", "force_n=[0.0, 0.0, -5.0]")]
)
def test_payload_and_contact_that_come_and_go_are_refused_too(kind: str, keys: str) -> None:
    setting = f'fault=[{{kind="friction", factor=2.0}}, {{kind="{kind}", {keys}}}]'
    scenario = load_scenario("paper_example2", [setting], SCENARIOS).scenario
    expected = f"fault[1].kind: found '{kind}' with the closed-form plant 'arm2'"
    with pytest.raises(InputError) as caught:
        check_rig(scenario, CLOSED)
    assert str(caught.value) == f"{expected} (expected a kind that acts on joints)"
    with pytest.raises(InputError) as caught:
        plant_of(CLOSED, faults=scenario.fault)
    assert str(caught.value).startswith(expected)
    check_rig(scenario, URDF)


def test_a_friction_fault_acts_on_a_closed_form() -> None:
    fault = FrictionFault(factor=3.0)
    one = plant_of(PENDULUMS, np.zeros(2), V0, faults=(fault,), viscous=0.1, coulomb=0.2)
    other = plant_of(PENDULUMS, np.zeros(2), V0, viscous=0.3, coulomb=0.6)
    one.advance(40)
    other.advance(40)
    np.testing.assert_allclose(one.q, other.q, rtol=1e-12)


def test_no_armature_is_no_addition() -> None:
    scenario = load_scenario("paper_example2", ["rig.plant.armature=0.0"], SCENARIOS).scenario
    check_rig(scenario, CLOSED)
