"""Properties of the dynamics, on every URDF of example-robot-data that is supported."""

import functools

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dftc_rt.dynamics.local_terms import LocalTerms
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.split import split
from dftc_rt.dynamics.surrogate import INTERCONNECTIONS, surrogate
from dftc_rt.dynamics.urdf import data_dir, read_urdf
from dftc_rt.dynamics.whole_body import WholeBody
from dftc_rt.errors import InputError

# Every URDF that is refused, by name, with the reason.
REFUSED = {
    "hector_description/robots/quadrotor_base.urdf": "no joint that can move",
    "icub_description/robots/icub.urdf": "mass matrix is singular",
    "iris_description/robots/iris_simple.urdf": "no joint that can move",
    "romeo_description/urdf/romeo.urdf": "moves no mass",
    "romeo_description/urdf/romeo_laas_small.urdf": "moves a body with a moment of -0.00272",
    "ur_description/urdf/ur3.urdf": "no joint that can move",
}
ALL = sorted(str(path.relative_to(data_dir())) for path in data_dir().rglob("*.urdf"))
LOADED = [urdf for urdf in ALL if urdf not in REFUSED]

few = settings(
    max_examples=8, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)  # fmt: skip
seeds = st.integers(0, 2**32 - 1)


@functools.cache
def robot_of(urdf):
    return load_robot(urdf=urdf, lock=mimics_of(urdf))


def mimics_of(urdf):
    checked = read_urdf(data_dir() / urdf)
    return [j.name for j in checked.joints if j.mimics and j.name in checked.movable]


def state(robot, rng):
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return rng.uniform(low, high), rng.normal(0.0, 1.5, robot.n), rng.normal(0.0, 5.0, robot.n)


def test_the_data_set_is_there_and_so_are_the_exceptions():
    assert len(LOADED) > 55
    assert set(REFUSED) <= set(ALL)


@pytest.mark.parametrize("urdf", sorted(REFUSED))
def test_refused_robots_are_refused_in_one_line(urdf):
    with pytest.raises(InputError) as caught:
        load_robot(urdf=urdf, lock=mimics_of(urdf))
    assert REFUSED[urdf] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("urdf", LOADED)
@few
@given(seed=seeds)
def test_local_terms_and_interconnection_make_the_whole(urdf, seed):
    robot = robot_of(urdf)
    rng = np.random.default_rng(seed)
    (q, v, a), (qd, vd, ad), (frozen, _, _) = (state(robot, rng) for _ in range(3))
    body = WholeBody(robot)
    whole = body.inverse_dynamics(q, v, a)
    scale = (
        np.abs(body.mass_matrix(q)) @ np.abs(a)
        + np.abs(body.coriolis_matrix(q, v)) @ np.abs(v)
        + np.abs(body.gravity(q))
    ).max()
    for interconnection in INTERCONNECTIONS:
        qs, vs, as_ = surrogate(interconnection, frozen, q, v, qd, vd, ad)
        terms = split(robot, q, v, a, qs, vs, as_)
        local = terms.inertia * a + terms.coriolis + terms.gravity
        np.testing.assert_allclose(local + terms.interconnection, whole, rtol=0, atol=1e-9 * scale)

        # The recursive passes of the loop against the matrices of the definition.
        online = LocalTerms(robot, interconnection, frozen)
        online.update(q, v, qd, vd, ad)
        bias = terms.coriolis + terms.gravity + terms.expected
        size = max(scale, np.abs(bias).max())
        np.testing.assert_allclose(online.inertia, terms.inertia, rtol=1e-9)
        np.testing.assert_allclose(online.bias, bias, rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("urdf", LOADED)
@few
@given(seed=seeds)
def test_mass_matrix_is_positive_definite_and_passive(urdf, seed):
    robot = robot_of(urdf)
    body = WholeBody(robot)
    q, v, a = state(robot, np.random.default_rng(seed))
    M, C = body.mass_matrix(q), body.coriolis_matrix(q, v)
    np.testing.assert_array_equal(M, M.T)
    assert np.linalg.eigvalsh(M)[0] > 0.0
    step = 1e-5
    M_dot = (body.mass_matrix(q + step * v) - body.mass_matrix(q - step * v)) / (2.0 * step)
    size = max(1.0, np.abs(M_dot).max())
    skew = M_dot - 2.0 * C
    np.testing.assert_allclose(skew + skew.T, 0.0, atol=1e-6 * size)
    back = body.forward_dynamics(q, v, body.inverse_dynamics(q, v, a))
    np.testing.assert_allclose(back, a, atol=1e-6 * np.linalg.cond(M) ** 0.5 * np.abs(a).max())


@pytest.mark.parametrize("urdf", [
    "panda_description/urdf/panda_collision.urdf",
    "kinova_description/robots/kinova.urdf",  # continuous joints
    "baxter_description/urdf/baxter.urdf",  # a tree, with prismatic joints
])  # fmt: skip
@pytest.mark.parametrize("interconnection", ["frozen", "desired"])
@few
@given(seed=seeds)
def test_what_a_joint_reads_of_the_others_is_nothing(urdf, interconnection, seed):
    robot = robot_of(urdf)
    rng = np.random.default_rng(seed)
    (q, v, _), (qd, vd, ad), (q_else, v_else, _) = (state(robot, rng) for _ in range(3))
    terms = LocalTerms(robot, interconnection)
    terms.update(q, v, qd, vd, ad)
    inertia, bias = terms.inertia.copy(), terms.bias.copy()
    for j in range(robot.n):
        others = np.arange(robot.n) != j
        q_j, v_j = np.where(others, q, q_else), np.where(others, v, v_else)
        terms.update(q_j, v_j, qd, vd, ad)
        assert terms.inertia[others].tobytes() == inertia[others].tobytes()
        assert terms.bias[others].tobytes() == bias[others].tobytes()
    terms.update(q_else, v_else, qd, vd, ad)
    assert not np.array_equal(terms.bias, bias)  # they do read their own state
