"""Payloads and contacts that come and go, against robots built so and against statics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from dftc_rt.config.faults import ContactFault, FrictionFault, PayloadFault
from dftc_rt.dynamics.payload import with_payload
from dftc_rt.dynamics.robot import load_robot
from hil.plants.rigid_body import RigidBodyPlant
from tests.unit.hil.test_rigid_body import plant_of

F64 = NDArray[np.float64]

PANDA = load_robot("panda")
Q0 = PANDA.home + np.array([0.1, -0.2, 0.3, 0.1, -0.3, 0.2, 0.4])
V0 = np.array([0.5, -0.4, 0.3, 0.6, -0.5, 0.4, 0.7])
COM = (0.03, -0.02, 0.12)


def run(plant: RigidBodyPlant, steps: int) -> RigidBodyPlant:
    for k in range(steps):
        plant.command[:] = 5.0 * np.sin(0.03 * k + np.arange(7))
        plant.advance(1)
    return plant


def go_on(state: RigidBodyPlant, **table: Any) -> RigidBodyPlant:
    return plant_of(PANDA, state.q, state.v, **table)


def test_a_payload_makes_the_robot_that_is_built_with_it_and_leaves_the_one_without() -> None:
    fault = PayloadFault(payload_kg=2.0, com_m=COM, start_s=0.05, end_s=0.1)
    plant = run(plant_of(PANDA, Q0, V0, faults=(fault,)), 200)
    bare = run(plant_of(PANDA, Q0, V0), 200)
    assert np.array_equal(plant.q, bare.q)
    built = run(go_on(plant, payload_kg=2.0, payload_com_m=COM), 200)
    other = run(go_on(plant), 200)
    run(plant, 200)
    assert np.array_equal(plant.q, built.q)
    assert np.array_equal(plant.v, built.v)
    assert np.abs(plant.v - other.v).max() > 0.02
    assert plant.fault.tolist() == [1.0] * 7
    assert plant.rho.tolist() == [1.0] * 7
    after = run(go_on(plant), 200)
    run(plant, 200)
    assert np.array_equal(plant.q, after.q)
    assert not plant.fault.any()


def test_payloads_add_to_each_other_and_to_the_plants_own() -> None:
    faults = (
        PayloadFault(payload_kg=1.0, com_m=COM),
        PayloadFault(payload_kg=0.5, com_m=COM, end_s=0.01),
    )
    plant = run(plant_of(PANDA, Q0, V0, faults=faults, payload_kg=0.5, payload_com_m=COM), 40)
    built = run(plant_of(PANDA, Q0, V0, payload_kg=2.0, payload_com_m=COM), 40)
    np.testing.assert_allclose(plant.v, built.v, rtol=0, atol=1e-10)
    lighter = run(go_on(plant, payload_kg=1.5, payload_com_m=COM), 40)
    run(plant, 40)
    np.testing.assert_allclose(plant.v, lighter.v, rtol=0, atol=1e-10)


def test_a_payload_on_the_link_behind_a_joint_that_is_named() -> None:
    fault = PayloadFault(joint="panda_joint4", payload_kg=2.0, com_m=COM)
    plant = plant_of(PANDA, Q0, V0, faults=(fault,))
    plant.advance(1)
    model = with_payload(PANDA, 2.0, COM, "panda_joint4")
    a = pin.aba(model, model.createData(), Q0, V0, np.zeros(7))
    np.testing.assert_allclose(plant.v, V0 + plant.dt * a, rtol=1e-12)


def test_a_robot_is_not_changed_by_what_its_rig_carries() -> None:
    masses = [inertia.mass for inertia in PANDA.model.inertias]
    run(plant_of(PANDA, faults=(PayloadFault(payload_kg=2.0),), friction="lugre", coulomb=1.0), 8)
    assert [inertia.mass for inertia in PANDA.model.inertias] == masses
    assert PANDA.armature.tolist() == load_robot("panda").armature.tolist()


def test_contact_on_arm2_is_force_times_lever() -> None:
    # Link 2's origin is 0.3 m along link 1, which leans by q1 from the upright, towards x.
    q1, force = 0.4, (20.0, 7.0, -10.0)
    arm2 = load_robot("arm2", gravity_m_s2=(0.0, 0.0, 0.0))
    fault = ContactFault(force_n=force, start_s=0.001, end_s=0.002)
    plant = plant_of(arm2, np.array([q1, 0.0]), faults=(fault,), closed=(1,), substeps=1)
    torque = 0.3 * (np.cos(q1) * force[0] - np.sin(q1) * force[2])
    inertia = 0.36 + 0.6066  # M_11 of [zhao2017] eq. (35) with the arm stretched
    plant.advance(1)
    assert plant.v[0] == 0.0
    plant.advance(1)
    assert plant.v[0] == pytest.approx(torque / inertia * plant.dt, rel=1e-9)
    assert not plant.applied.any()  # it is not the motors'
    before = plant.v[0]
    plant.advance(1)
    assert plant.v[0] == before


@pytest.mark.parametrize("joint", [None, "panda_joint5"])
def test_contact_does_the_work_of_a_force_on_the_links_origin(joint: str | None) -> None:
    force = np.array([4.0, -7.0, -20.0])
    fault = ContactFault(joint=joint, force_n=(4.0, -7.0, -20.0))
    pushed, free = plant_of(PANDA, Q0, faults=(fault,)), plant_of(PANDA, Q0)
    pushed.advance(1)
    free.advance(1)
    model, data = PANDA.model, PANDA.model.createData()
    M = pin.crba(model, data, Q0)
    torque = (np.triu(M) + np.triu(M, 1).T) @ (pushed.v - free.v) / pushed.dt

    def place(q: F64) -> F64:
        pin.forwardKinematics(model, data, q)
        found: F64 = data.oMi[7 if joint is None else 5].translation.copy()
        return found

    h = 1e-6
    by_work = [(place(Q0 + h * e) - place(Q0 - h * e)) @ force / (2 * h) for e in np.eye(7)]
    np.testing.assert_allclose(torque, by_work, rtol=0, atol=1e-7)
    assert np.abs(torque).max() > 1.0


def test_friction_that_rises_is_friction_that_was_higher() -> None:
    faults = (FrictionFault(joint="panda_joint2", factor=1.5), FrictionFault(factor=2.0))
    table: dict[str, Any] = {"viscous": 0.4, "coulomb": 0.6}
    for friction in ("coulomb", "lugre"):
        plant = run(plant_of(PANDA, Q0, V0, faults=faults, friction=friction, **table), 80)
        factor = np.full(7, 2.0)
        factor[1] = 3.0
        table_there = {key: tuple((value * factor).tolist()) for key, value in table.items()}
        presliding = tuple((2e-4 * factor).tolist()) if friction == "lugre" else 2e-4
        there = plant_of(
            PANDA, Q0, V0, friction=friction, presliding_rad=presliding, **table_there
        )  # stiffness stays, so static friction is reached further on
        run(there, 80)
        np.testing.assert_allclose(plant.v, there.v, rtol=0, atol=1e-9)
        assert np.abs(plant.v - run(plant_of(PANDA, Q0, V0), 80).v).max() > 1e-2
