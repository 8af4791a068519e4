"""The closed forms against the printed equations, mechanics, and each other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dftc_rt.dynamics.closed_form import pendulums
from dftc_rt.dynamics.closed_form.plants import CLOSED_FORMS
from dftc_rt.dynamics.closed_form.whole_body import ClosedFormBody

PRINTED = ClosedFormBody(CLOSED_FORMS["pendulums"])
PHYSICAL = ClosedFormBody(CLOSED_FORMS["pendulums_physical"])
ARM_M = 0.1  # a, where the spring is attached
ZERO = np.zeros(2)
angles = st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)).map(np.array)
speeds = st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)).map(np.array)
many = settings(max_examples=100, deadline=None, derandomize=True)


def spring_by_hand(q):
    """Tension, N, and direction, rad, from where the ends of the spring are."""
    one = np.array([ARM_M * np.sin(q[0]), ARM_M * np.cos(q[0])])
    two = np.array([1.0 + ARM_M * np.sin(q[1]), ARM_M * np.cos(q[1])])
    length = np.linalg.norm(two - one)
    stretch = length - 1.0
    # β of the paper is counted from the horizontal to the side of the first pendulum.
    beta = -np.arctan2((two - one)[1], (two - one)[0])
    return 30.0 * (1.0 + 0.1**2 * stretch**2) * stretch, beta


@pytest.mark.parametrize("name", list(CLOSED_FORMS))
@many
@given(q=angles, v=speeds, a=speeds)
def test_forward_and_inverse_dynamics_undo_each_other(name, q, v, a):
    body = ClosedFormBody(CLOSED_FORMS[name])
    tau = body.inverse_dynamics(q, v, a)
    size = max(1.0, np.abs(tau).max())
    np.testing.assert_allclose(body.forward_dynamics(q, v, tau), a, rtol=0, atol=1e-10 * size)
    bias = body.inverse_dynamics(q, v, ZERO)
    np.testing.assert_allclose(body.mass_matrix(q) @ a + bias, tau, rtol=0, atol=1e-12 * size)


@many
@given(q=angles, v=speeds, u=speeds)
def test_state_form_is_the_printed_one(q, v, u):
    tension, beta = spring_by_hand(q)
    expected = 5.88 * np.sin(q) - 0.036 * v + 4.0 * tension * 0.1 * np.cos(q - beta) + u
    found = PRINTED.forward_dynamics(q, v, u)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@many
@given(q=angles, v=speeds, u=speeds)
def test_physical_pair_is_the_printed_34_with_the_second_sign_turned(q, v, u):
    tension, beta = spring_by_hand(q)
    pull = tension * 0.1 * np.cos(q - beta) * [1.0, -1.0]
    a = PHYSICAL.forward_dynamics(q, v, u)
    left = 1.0 * 0.5**2 * a - 1.0 * 9.8 * 0.5 * np.sin(q) + 0.009 * v - pull
    np.testing.assert_allclose(left, u, rtol=0, atol=1e-11)


def test_spring_at_three_poses_by_hand():
    assert pendulums.spring(0.3, 0.3) == (0.0, 0.0, 1.0)
    tension, beta, length = pendulums.spring(-np.pi / 2, np.pi / 2)  # lying outwards
    assert (length, beta) == (pytest.approx(1.2), pytest.approx(0.0, abs=1e-15))
    assert tension == pytest.approx(30.0 * 1.0004 * 0.2)
    tension, beta, length = pendulums.spring(0.0, np.pi / 2)  # ends at (0, 0.1) and (1.1, 0)
    assert length == pytest.approx(np.sqrt(1.22))
    assert beta == pytest.approx(np.arctan(0.1 / 1.1))
    assert tension > 0.0


def force_on_each_end(body, inertia, gravity, q):
    """Force along the spring that its torque on each pendulum amounts to, N."""
    torque = -(body.inverse_dynamics(q, ZERO, ZERO) + gravity * np.sin(q)) * 0.25 / inertia
    return torque / (ARM_M * np.cos(q - spring_by_hand(q)[1]))


@many
@given(q=angles.filter(lambda q: np.abs(np.cos(q)).min() > 0.3 and abs(q[0] - q[1]) > 0.1))
def test_printed_signs_break_newtons_third_law(q):
    tension, _ = spring_by_hand(q)
    printed = force_on_each_end(PRINTED, 1.0, 5.88, q)
    physical = force_on_each_end(PHYSICAL, 0.25, 4.9, q)
    np.testing.assert_allclose(physical, [tension, -tension], atol=1e-9)
    np.testing.assert_allclose(printed, [tension, tension], atol=1e-9)
    assert physical.sum() == pytest.approx(0.0, abs=1e-9)
    assert printed.sum() == pytest.approx(2.0 * tension, abs=1e-9)


@pytest.mark.parametrize(
    ("body", "gravity", "input_gain"), [(PRINTED, 5.88, 1.0), (PHYSICAL, 19.6, 4.0)]
)
def test_state_form_and_34_have_different_numbers(body, gravity, input_gain):
    q = np.array([0.7, 0.7])  # the spring is as long as at rest
    free = body.forward_dynamics(q, ZERO, ZERO)
    np.testing.assert_allclose(free, gravity * np.sin(q), rtol=1e-12)
    driven = body.forward_dynamics(q, ZERO, np.array([1.0, -2.0]))
    np.testing.assert_allclose(driven - free, np.array([1.0, -2.0]) * input_gain, rtol=1e-12)


@many
@given(q=angles)
def test_torque_of_the_physical_pair_is_the_gradient_of_its_energy(q):
    step = 1e-5
    for i, shift in enumerate(np.eye(2) * step):
        up, down = (pendulums.physical_energy(x, ZERO) for x in (q + shift, q - shift))
        holding = PHYSICAL.inverse_dynamics(q, ZERO, ZERO)[i]
        assert holding == pytest.approx((up - down) / (2.0 * step), abs=1e-7)


@many
@given(q=angles)
def test_printed_spring_has_no_potential(q):
    """∂τ_1/∂q_2 = ∂τ_2/∂q_1 of a gradient; with the printed signs the two are opposite."""
    step = 1e-5

    def cross(body):
        def torque(joint, shift):
            return body.inverse_dynamics(q + np.array(shift), ZERO, ZERO)[joint]

        first = torque(0, (0.0, step)) - torque(0, (0.0, -step))
        second = torque(1, (step, 0.0)) - torque(1, (-step, 0.0))
        return first / (2.0 * step), second / (2.0 * step)

    one, two = cross(PHYSICAL)
    assert one == pytest.approx(two, abs=1e-8)
    one, two = cross(PRINTED)
    assert one == pytest.approx(-two, abs=1e-7)


@many
@given(q=angles, v=speeds, u=speeds)
def test_power_into_the_physical_pair_is_that_of_torque_and_damping(q, v, u):
    a = PHYSICAL.forward_dynamics(q, v, u)
    step = 1e-6
    up, down = (pendulums.physical_energy(q + s * v, v + s * a) for s in (step, -step))
    expected = u @ v - 0.009 * v @ v
    assert (up - down) / (2.0 * step) == pytest.approx(expected, abs=1e-4)


def test_energy_of_the_physical_pair_along_a_fine_integration():
    """Runge-Kutta of fourth order, 2 s of free swinging: only the damping takes energy away."""
    h, steps = 1e-3, 2000
    q, v, lost = np.array([0.4, -0.2]), np.array([0.0, 1.0]), 0.0
    start = pendulums.physical_energy(q, v)

    def rate(x):
        return np.concatenate([x[2:4], PHYSICAL.forward_dynamics(x[:2].copy(), x[2:4].copy(), ZERO),
                               [0.009 * x[2:4] @ x[2:4]]])  # fmt: skip

    x = np.concatenate([q, v, [lost]])
    for _ in range(steps):
        k1 = rate(x)
        k2 = rate(x + 0.5 * h * k1)
        k3 = rate(x + 0.5 * h * k2)
        k4 = rate(x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    assert x[4] > 0.1  # J, so that there is something to see
    end = pendulums.physical_energy(x[:2], x[2:4])
    assert end + x[4] == pytest.approx(start, abs=1e-8)
