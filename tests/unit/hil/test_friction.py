"""Friction of the true joints against cases worked out by hand, and against thermodynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.config.scenario import PlantTable
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.errors import InputError
from hil.plants import layout
from hil.plants.friction import DAMPING_S, bend, joint_parameters, resist
from hil.plants.rigid_body import RigidBodyPlant
from tests.unit.hil.test_rigid_body import plant_of

F64 = NDArray[np.float64]

WEIGHTLESS = load_robot("arm2", gravity_m_s2=(0.0, 0.0, 0.0))
LIMIT = WEIGHTLESS.torque_limit[1]  # 100 Nm
INERTIA = 0.1233  # kg m^2, joint 2 about its axis: [zhao2017] eq. (35)
DT = 2.5e-4
COULOMB, STATIC, PRESLIDING = 2.0, 2.6, 2e-4  # Nm, Nm, rad
STIFFNESS = STATIC / PRESLIDING
TABLE: dict[str, Any] = {
    "friction": "lugre", "coulomb": COULOMB, "viscous": 0.7, "load_friction": 0.0,
}  # fmt: skip


class Joints:
    """The friction of arm2's joints by itself, moved along a prescribed motion."""

    def __init__(self, dt: float = DT, **table: Any) -> None:
        self.dt = dt
        self.joints = joint_parameters(WEIGHTLESS, PlantTable(**(TABLE | table)))
        self.rows = np.zeros((layout.N_STATE, 2))
        self.rows[layout.FRICTION] = self.rows[layout.DECAY] = 1.0
        self.v, self._tau = np.zeros((2, 2))

    @property
    def bristle(self) -> F64:
        return self.rows[layout.BRISTLE]

    def step(self, v: F64 | float, applied: float = 0.0) -> F64:
        """Friction at the end of a substep at whose end the velocity is ``v``, Nm."""
        self.rows[layout.APPLIED] = applied
        resist(self.dt, self.v, self.joints, self.rows, self._tau)
        force = applied - self._tau + self.rows[layout.ADDED] / self.dt * (v - self.v)
        self.v[:] = v
        bend(self.v, self.rows)
        return force


def joint2(v2: float = 0.0, **table: Any) -> RigidBodyPlant:
    """Joint 2 of a weightless arm2 at 0.4 rad, joint 1 braked."""
    return both(v2, closed=(0,), **table)


def both(v2: float = 0.0, **table: Any) -> RigidBodyPlant:
    """A weightless arm2 at (0, 0.4) rad."""
    q0, v0 = np.array([0.0, 0.4]), np.array([0.0, v2])
    return plant_of(WEIGHTLESS, q0, v0, **(TABLE | table))


# --- sliding -----------------------------------------------------------------------------


@pytest.mark.parametrize("v", [0.005, 0.05, 0.3, 2.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_steady_sliding_is_stribecks_curve_and_viscous_friction(v: float, sign: float) -> None:
    friction = Joints()
    for _ in range(4000):
        force = friction.step(sign * v)
    g = {0.005: 2.0 + 0.6 * 0.9900498, 0.05: 2.0 + 0.6 * 0.3678794, 0.3: 2.0, 2.0: 2.0}[v]
    assert force == pytest.approx(sign * (g + 0.7 * v), rel=1e-6)
    assert friction.bristle == pytest.approx(sign * g / STIFFNESS, rel=1e-6)


def test_load_and_a_fault_raise_sliding_friction() -> None:
    friction = Joints(load_friction=0.3)
    for _ in range(2000):
        force = friction.step(1.0, applied=-0.5 * LIMIT)
    assert force[1] == pytest.approx(2.0 * (1 + 0.3 * 0.5) + 0.7, rel=1e-9)
    friction.rows[layout.FRICTION] = 1.5
    for _ in range(2000):
        force = friction.step(1.0, applied=-0.5 * LIMIT)
    assert force[1] == pytest.approx(1.5 * (2.0 * (1 + 0.3 * 0.5) + 0.7), rel=1e-9)


def test_bristles_do_not_overshoot_when_motion_begins_or_turns_at_speed() -> None:
    friction = Joints()
    for v in (3.0, 3.0, -3.0, -3.0, -3.0, 0.4, -0.4):
        friction.step(v)
        friction.step(v)
        assert np.all(np.abs(friction.bristle) <= PRESLIDING)


# --- sticking ----------------------------------------------------------------------------


@pytest.mark.parametrize("load", [0.0, 0.3])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_breaks_away_at_static_friction(load: float, sign: float) -> None:
    plant = joint2(load_friction=load)
    breakaway = STATIC / (1.0 - load * STATIC / LIMIT)  # tau = STATIC (1 + load tau / LIMIT)
    for k in range(1000):  # not in a step, which overshoots
        plant.command[1] = sign * 0.98 * breakaway * min(k / 800, 1.0)
        plant.advance(4)
    assert abs(plant.v[1]) < 1e-5
    assert abs(plant.q[1] - 0.4) < 2.0 * PRESLIDING
    plant.command[1] = sign * 1.02 * breakaway
    plant.advance(4000)
    assert sign * plant.v[1] > 0.1


def test_presliding_is_a_spring_that_comes_back_and_dissipates() -> None:
    plant = joint2()
    plant.command[1] = 0.5 * STATIC
    furthest = 0.0
    for _ in range(400):
        plant.advance(4)
        furthest = max(furthest, plant.q[1] - 0.4)
    assert plant.q[1] - 0.4 == pytest.approx(0.5 * PRESLIDING, rel=1e-6)
    # A step of torque on a spring with damping overshoots by exp(-pi zeta / sqrt(1 - zeta^2)).
    zeta = (STIFFNESS * DAMPING_S + 0.7) / (2.0 * np.sqrt(STIFFNESS * INERTIA))
    overshoot = np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2))
    assert furthest / (0.5 * PRESLIDING) - 1.0 == pytest.approx(overshoot, abs=0.1)
    plant.command[1] = 0.0
    plant.advance(1600)
    assert plant.q[1] == pytest.approx(0.4, abs=1e-9)


def test_a_cycle_near_breakaway_leaves_a_loop() -> None:
    friction = Joints(viscous=0.0)
    phase = np.linspace(0.0, 6 * np.pi, 120_000)
    v = 0.95 * PRESLIDING * np.diff(np.sin(phase)) / DT
    work = [float((friction.step(each) * each)[1]) * DT for each in v]
    # Between two full cycles the bristles come back: what is left went into heat.
    loop = sum(work[40_000:80_000])
    assert 0.02 * STATIC * PRESLIDING < loop < 2.0 * STATIC * PRESLIDING


@pytest.mark.parametrize("ripple", [0.0, 0.25])
def test_holds_below_static_friction_without_drift(ripple: float) -> None:
    plant = both(viscous=0.0)
    noise = np.random.default_rng(5).uniform(-ripple, ripple, 10_000)
    places = []
    for k in range(10_000):
        plant.command[1] = (0.4 + noise[k]) * STATIC
        plant.advance(4)
        places.append(plant.q[1] - 0.4)
    late = np.array(places).reshape(10, -1).mean(axis=1)  # of each second
    assert late == pytest.approx([0.4 * PRESLIDING] * 10, abs=2e-2 * PRESLIDING)
    assert late[-1] == pytest.approx(late[1], abs=5e-3 * PRESLIDING)


# --- the integration -----------------------------------------------------------------------


@pytest.mark.parametrize("dt", [1e-3, DT, 1e-5])
@pytest.mark.parametrize("scale", [1e-3, 0.03, 3.0])
def test_no_motion_gets_energy_out_of_the_bristles(dt: float, scale: float) -> None:
    rng = np.random.default_rng(11)
    friction = Joints(dt=dt, viscous=0.0, load_friction=0.5)
    gained = np.zeros(2)
    for k in range(5000):
        v = friction.v + scale * rng.normal(0.0, 0.3, 2) - 0.05 * friction.v
        if k % 40 == 0:
            v = -v
        stored = 0.5 * friction.joints[layout.STIFFNESS] * friction.bristle**2
        force = friction.step(v, applied=float(rng.normal(0.0, 40.0)))
        stored = 0.5 * friction.joints[layout.STIFFNESS] * friction.bristle**2 - stored
        gained = np.maximum(gained, stored - force * v * dt)
    assert gained.max() < 1e-12


@pytest.mark.parametrize("presliding", [2e-4, 1e-6, 1e-9])
@pytest.mark.parametrize("substeps", [1, 4])
def test_no_bristle_is_too_stiff_for_the_step(presliding: float, substeps: int) -> None:
    plant = joint2(v2=0.5, presliding_rad=presliding, viscous=0.0, substeps=substeps)
    plant.command[1] = 0.9 * COULOMB
    energy = 0.5 * INERTIA * 0.5**2
    for _ in range(1000):
        q = plant.q[1]
        plant.advance(substeps)
        energy += plant.command[1] * (plant.q[1] - q)
        assert 0.5 * INERTIA * plant.v[1] ** 2 <= energy + 1e-6
    assert abs(plant.v[1]) < 1e-4


def test_half_the_step_changes_little() -> None:
    ends = {}
    for substeps in (4, 8, 64):
        plant = both(substeps=substeps)
        path = []
        for k in range(3000):
            plant.command[:] = 5.0 * np.sin(2 * np.pi * 0.7 * k * 1e-3) + 1.5
            plant.advance(substeps)
            path.append(plant.q.copy())
        ends[substeps] = np.array(path)
    travel = np.ptp(ends[64], axis=0).min()
    assert travel > 0.3
    assert np.abs(ends[4] - ends[64]).max() < 0.02 * travel
    assert np.abs(ends[8] - ends[64]).max() < 0.6 * np.abs(ends[4] - ends[64]).max()


def test_closed_form_and_urdf_have_the_same_friction() -> None:
    q0, v0 = np.array([0.3, -0.8]), np.array([1.0, -2.0])
    for closed in ((), (0,), (1,)):
        ends = []
        for robot in (load_robot("arm2"), load_robot(plant="arm2")):
            plant = plant_of(robot, q0, v0, closed=closed, **TABLE)
            plant.command[:] = [2.0, -1.0]
            plant.advance(1200)
            ends.append(plant.q.copy())
        np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-9)
        assert np.abs(ends[0] - q0).max() > 0.01


def test_bristles_add_no_inertia_to_a_brake() -> None:
    # What a substep adds for friction is gone when a brake takes a joint's momentum.
    velocities = []
    for robot in (load_robot("arm2"), load_robot(plant="arm2")):
        plant = plant_of(robot, v0=np.array([1.0, -2.0]), **TABLE)
        plant.advance(8)
        plant.set_brakes(np.array([True, False]))
        velocities.append(plant.v.tolist())
    assert velocities[0] == pytest.approx(velocities[1], rel=1e-9)
    assert velocities[1][1] == 0.0


# --- keys ----------------------------------------------------------------------------------


def test_fractions_are_of_the_torque_limit() -> None:
    table = PlantTable(coulomb_fraction=(0.02, 0.03), viscous_fraction=0.01, torque_constant=0.9)
    joints = joint_parameters(WEIGHTLESS, table)
    assert WEIGHTLESS.torque_limit.tolist() == [200.0, 100.0]
    assert joints[layout.COULOMB].tolist() == pytest.approx([4.0, 3.0])
    assert joints[layout.VISCOUS].tolist() == pytest.approx([2.0, 1.0])
    assert joints[layout.TORQUE_CONSTANT].tolist() == [0.9, 0.9]
    assert not joints[layout.STIFFNESS].any()


def test_without_coulomb_friction_a_joint_slides() -> None:
    joints = joint_parameters(WEIGHTLESS, PlantTable(friction="lugre", coulomb=(1.0, 0.0)))
    assert joints[layout.STIFFNESS].tolist() == pytest.approx([1.3 / 2e-4, 0.0])
    plant = joint2(v2=1.0, coulomb=(1.0, 0.0), viscous=0.0)
    plant.advance(400)
    assert plant.v[1] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"coulomb": 1.0, "coulomb_fraction": 0.02},
         "rig.plant.coulomb_fraction: found 0.02 beside coulomb (expected one of the two)"),
        ({"viscous": (1.0, 0.0), "viscous_fraction": (0.0, 0.1)},
         "rig.plant.viscous_fraction: found [0.0, 0.1] beside viscous (expected one of the two)"),
        ({"stribeck": 1.5},
         "rig.plant.stribeck: found 1.5 with friction = 'coulomb' (expected friction = 'lugre')"),
        ({"friction": "lugre"},
         "rig.plant.friction: found 'lugre', and no joint has Coulomb friction "
         "(expected coulomb or coulomb_fraction above 0)"),
        ({"friction": "lugre", "coulomb": 1.0, "presliding_rad": (1e-4,) * 3},
         "rig.plant.presliding_rad: 3 values (expected 1 or 2, one per joint)"),
    ],
)  # fmt: skip
def test_contradictions_are_one_line(table: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        joint_parameters(WEIGHTLESS, PlantTable(**table))
    assert str(caught.value) == message
