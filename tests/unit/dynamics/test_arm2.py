"""The URDF of arm2, and the closed form, against [zhao2017] eq. (35), typed in by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dftc_rt.dynamics.local_terms import LocalTerms
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.select import local_terms, whole_body
from dftc_rt.dynamics.surrogate import INTERCONNECTIONS
from dftc_rt.dynamics.whole_body import WholeBody

ROBOT = load_robot("arm2")
CLOSED = load_robot(plant="arm2")
ZERO = np.zeros(2)
angle = st.floats(-6.0, 6.0)
speed = st.floats(-10.0, 10.0)


def paper(q, v):
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    M = np.array([[0.36 * c2 + 0.6066, 0.18 * c2 + 0.1233], [0.18 * c2 + 0.1233, 0.1233]])
    C = np.array([
        [-0.36 * s2 * v[1], -0.18 * s2 * v[1]],
        [0.18 * s2 * (v[0] - v[1]), 0.18 * s2 * v[0]],
    ])  # fmt: skip
    G = np.array([
        -5.88 * np.sin(q[0] + q[1]) - 17.64 * np.sin(q[0]),
        -5.88 * np.sin(q[0] + q[1]),
    ])  # fmt: skip
    return M, C, G


@settings(max_examples=100, deadline=None, derandomize=True)
@given(q=st.tuples(angle, angle), v=st.tuples(speed, speed))
def test_urdf_gives_the_papers_terms(q, v):
    q, v = np.array(q), np.array(v)
    M, C, G = paper(q, v)
    body = WholeBody(ROBOT)
    np.testing.assert_allclose(body.mass_matrix(q), M, rtol=0, atol=1e-12)
    np.testing.assert_allclose(body.gravity(q), G, rtol=0, atol=1e-12)
    scale = max(1.0, np.abs(v).max() ** 2)
    np.testing.assert_allclose(body.coriolis_matrix(q, v) @ v, C @ v, rtol=0, atol=1e-12 * scale)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(q=st.tuples(angle, angle), v=st.tuples(speed, speed))
def test_closed_form_gives_the_papers_terms(q, v):
    q, v = np.array(q), np.array(v)
    M, C, G = paper(q, v)
    body = whole_body(CLOSED)
    gravity = body.inverse_dynamics(q, ZERO, ZERO)
    np.testing.assert_allclose(body.mass_matrix(q), M, rtol=0, atol=1e-12)
    np.testing.assert_allclose(gravity, G, rtol=0, atol=1e-12)
    scale = max(1.0, np.abs(v).max() ** 2)
    coriolis = body.inverse_dynamics(q, v, ZERO) - gravity
    np.testing.assert_allclose(coriolis, C @ v, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("interconnection", INTERCONNECTIONS)
@settings(max_examples=50, deadline=None, derandomize=True)
@given(q=st.tuples(angle, angle), v=st.tuples(speed, speed), d=st.tuples(angle, angle))
def test_closed_form_and_urdf_have_the_same_local_terms(interconnection, q, v, d):
    q, v, qd = np.array(q), np.array(v), np.array(d)
    vd, ad = 0.5 * qd[::-1], 2.0 * qd
    pair = [local_terms(robot, interconnection) for robot in (ROBOT, CLOSED)]
    for terms in pair:
        terms.update(q, v, qd, vd, ad)
    scale = max(1.0, np.abs(v).max() ** 2, np.abs(vd).max() ** 2)
    np.testing.assert_allclose(pair[0].inertia, pair[1].inertia, rtol=0, atol=1e-12)
    np.testing.assert_allclose(pair[0].bias, pair[1].bias, rtol=0, atol=2e-12 * scale)


def test_no_armature_and_the_papers_gravity():
    assert ROBOT.armature.tolist() == [0.0, 0.0]
    assert ROBOT.gravity.tolist() == [0.0, 0.0, -9.8]


def test_desired_terms_by_hand():
    """Joint 1 at its own state, joint 2 at its desired one: row 1 of the closed form."""
    q, v = np.array([0.4, -1.1]), np.array([1.5, -2.0])
    qd, vd, ad = np.array([0.2, 0.7]), np.array([-0.3, 0.9]), np.array([4.0, -5.0])
    terms = LocalTerms(ROBOT, "desired")
    terms.update(q, v, qd, vd, ad)
    M, C, G = paper((q[0], qd[1]), (v[0], vd[1]))
    assert terms.inertia[0] == pytest.approx(M[0, 0], abs=1e-12)
    assert terms.bias[0] == pytest.approx(
        M[0, 1] * ad[1] + (C @ [v[0], vd[1]])[0] + G[0], abs=1e-12
    )
    M, C, G = paper((qd[0], q[1]), (vd[0], v[1]))
    assert terms.inertia[1] == pytest.approx(M[1, 1], abs=1e-12)
    assert terms.bias[1] == pytest.approx(
        M[1, 0] * ad[0] + (C @ [vd[0], v[1]])[1] + G[1], abs=1e-12
    )


def test_frozen_terms_are_gravity_about_the_frozen_arm():
    q, v = np.array([0.4, -1.1]), np.array([1.5, -2.0])
    frozen = np.array([0.3, 0.8])
    terms = LocalTerms(ROBOT, "frozen", frozen)
    terms.update(q, v, q, v, v)
    assert terms.inertia.tolist() == pytest.approx([0.36 * np.cos(0.8) + 0.6066, 0.1233], abs=1e-12)
    expected = [
        -5.88 * np.sin(0.4 + 0.8) - 17.64 * np.sin(0.4),
        -5.88 * np.sin(0.3 - 1.1),
    ]
    assert terms.bias.tolist() == pytest.approx(expected, abs=1e-12)


def test_measured_terms_are_the_whole_without_own_acceleration():
    q, v, ad = np.array([0.4, -1.1]), np.array([1.5, -2.0]), np.array([4.0, -5.0])
    terms = LocalTerms(ROBOT, "measured")
    terms.update(q, v, q + 1.0, v + 1.0, ad)
    M, C, G = paper(q, v)
    expected = M @ ad - np.diag(M) * ad + C @ v + G
    assert terms.bias.tolist() == pytest.approx(expected.tolist(), abs=1e-12)
