"""Properties of closed forms: their split adds up, and a joint reads nothing of the others."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dftc_rt.dynamics.closed_form.plants import CLOSED_FORMS
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.select import local_terms, whole_body
from dftc_rt.dynamics.split import split
from dftc_rt.dynamics.surrogate import INTERCONNECTIONS, surrogate

ROBOTS = {name: load_robot(plant=name) for name in CLOSED_FORMS}

few = settings(max_examples=40, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def state(robot, rng):
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return rng.uniform(low, high), rng.normal(0.0, 1.5, robot.n), rng.normal(0.0, 5.0, robot.n)


@pytest.mark.parametrize("name", list(CLOSED_FORMS))
@few
@given(seed=seeds)
def test_local_terms_and_interconnection_make_the_whole(name, seed):
    robot = ROBOTS[name]
    rng = np.random.default_rng(seed)
    (q, v, a), (qd, vd, ad), (frozen, _, _) = (state(robot, rng) for _ in range(3))
    whole = whole_body(robot).inverse_dynamics(q, v, a)
    for interconnection in INTERCONNECTIONS:
        qs, vs, as_ = surrogate(interconnection, frozen, q, v, qd, vd, ad)
        terms = split(robot, q, v, a, qs, vs, as_)
        local = terms.inertia * a + terms.coriolis + terms.gravity
        np.testing.assert_allclose(local + terms.interconnection, whole, rtol=0, atol=1e-11)

        # The loop's kernel against the definition.
        online = local_terms(robot, interconnection, frozen)
        online.update(q, v, qd, vd, ad)
        bias = terms.coriolis + terms.gravity + terms.expected
        np.testing.assert_allclose(online.inertia, terms.inertia, rtol=1e-14)
        np.testing.assert_allclose(online.bias, bias, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", list(CLOSED_FORMS))
@pytest.mark.parametrize("interconnection", ["frozen", "desired"])
@few
@given(seed=seeds)
def test_what_a_joint_reads_of_the_others_is_nothing(name, interconnection, seed):
    robot = ROBOTS[name]
    rng = np.random.default_rng(seed)
    (q, v, _), (qd, vd, ad), (q_else, v_else, _) = (state(robot, rng) for _ in range(3))
    terms = local_terms(robot, interconnection)
    terms.update(q, v, qd, vd, ad)
    inertia, bias = terms.inertia.copy(), terms.bias.copy()
    for j in range(robot.n):
        others = np.arange(robot.n) != j
        q_j, v_j = np.where(others, q, q_else), np.where(others, v, v_else)
        terms.update(q_j, v_j, qd, vd, ad)
        assert terms.inertia[others].tobytes() == inertia[others].tobytes()
        assert terms.bias[others].tobytes() == bias[others].tobytes()
        assert terms.bias[j] != bias[j]  # it does read its own state


@few
@given(seed=seeds)
def test_mass_matrices_are_symmetric_and_positive_definite(seed):
    rng = np.random.default_rng(seed)
    for robot in ROBOTS.values():
        M = whole_body(robot).mass_matrix(state(robot, rng)[0])
        np.testing.assert_array_equal(M, M.T)
        assert np.linalg.eigvalsh(M)[0] > 0.0
