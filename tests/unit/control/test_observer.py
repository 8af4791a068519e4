"""Estimators of the effectiveness against their equations and against a known truth."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dftc_rt.control import observer


def test_drive_lag_is_the_exact_solution() -> None:
    lag, h, start, u = 0.002, 0.001, 3.0, -1.0
    decay = np.exp(-h / lag)
    mean_weight = lag / h * (1 - decay)
    mean, end = observer.lagged(start, u, mean_weight, decay)
    exact = solve_ivp(
        lambda _t, x: [(u - x[0]) / lag, x[0]], (0, h), [start, 0.0], rtol=1e-11, atol=1e-12
    )
    assert end == pytest.approx(exact.y[0, -1], rel=1e-8)
    assert mean == pytest.approx(exact.y[1, -1] / h, rel=1e-8)


def test_required_torque_is_the_momentum_form() -> None:
    """M_mid Δv/h equals Δ(M v)/h - Ṁ v_mid, the momentum form."""
    m0, m1, v0, v1, h, bias = 1.0, 1.3, 0.2, 0.5, 0.01, 4.0
    momentum = (m1 * v1 - m0 * v0) / h - (m1 - m0) / h * 0.5 * (v0 + v1)
    got = observer.required(0.5 * (m0 + m1), v1 - v0, h, bias)
    assert got == pytest.approx(momentum + bias, rel=1e-12)


def test_kalman_is_the_textbook_filter() -> None:
    rho, p, phi, y, r = 0.9, 0.04, 5.0, 3.0, 0.5
    gain = p * phi / (phi * p * phi + r)
    got = observer.kalman(rho, p, phi, y, r, 0.0, 0.0, 1.0, 1e-3)
    assert got == pytest.approx((rho + gain * (y - phi * rho), (1 - gain * phi) * p))


def test_kalman_equals_batch_least_squares() -> None:
    """Without a random walk the filter is ridge least squares with the prior."""
    rng = np.random.default_rng(3)
    phi = rng.normal(0, 5, 200)
    y = 0.6 * phi + rng.normal(0, 0.7, 200)
    rho, p = 1.0, 0.09
    for a, b in zip(phi, y, strict=True):
        rho, p = observer.kalman(rho, p, a, b, 0.49, 0.0, 0.0, 1.0, 1e-3)
    weight = 1 / 0.09 + (phi @ phi) / 0.49
    assert rho == pytest.approx((1.0 / 0.09 + (phi @ y) / 0.49) / weight, rel=1e-9)
    assert p == pytest.approx(1 / weight, rel=1e-9)


def test_prediction_adds_the_walk_up_to_its_bound() -> None:
    assert observer.predict(0.01, 0.3, 0.001, 1.0) == pytest.approx(0.01 + 0.09 * 0.001)
    assert observer.predict(0.999, 30.0, 0.1, 1.0) == 1.0


@pytest.mark.parametrize("estimate", [observer.kalman, observer.gradient])
@pytest.mark.parametrize("true", [0.0, 0.4, 1.1])
def test_both_laws_find_rho_behind_one_interface(estimate, true: float) -> None:  # type: ignore[no-untyped-def]
    rho, aux, h = 1.0, 0.09 if estimate is observer.kalman else 0.0, 1e-3
    for k in range(3000):
        phi = 8.0 * np.sin(4.0 * k * h) + 10.0
        rho, aux = estimate(rho, aux, phi, true * phi, 1.0, 1000.0, 60.0, 0.5, h)
    assert rho == pytest.approx(true, abs=1e-2)


@pytest.mark.parametrize("estimate", [observer.kalman, observer.gradient])
def test_estimate_stays_in_its_range(estimate) -> None:  # type: ignore[no-untyped-def]
    for y in (-1e4, 1e4):
        rho, aux = 1.0, 1.0
        for _ in range(50):
            rho, aux = estimate(rho, aux, 10.0, y, 1.0, 1000.0, 60.0, 0.5, 1e-3)
            assert 0.0 <= rho <= observer.RHO_TOP


def test_gradient_is_equation_29_in_momentum_coordinates() -> None:
    """One step of (28), (29) on (v, x̂_2fo), normalised, equals one step on ε = e_2f/ĝ."""
    g, rho, e2f, phi, y, l2f, gamma, floor, h = 0.4, 0.9, 0.05, 6.0, 4.0, 60.0, 900.0, 0.5, 1e-3
    e2f_next = e2f + h * (g * y - g * rho * phi - l2f * e2f)
    rho_next = rho + h * gamma * e2f_next * g * phi / (g * g * (phi**2 + floor**2))
    got = observer.gradient(rho, e2f / g, phi, y, 1.0, gamma, l2f, floor, h)
    assert got == pytest.approx((rho_next, e2f_next / g))


def test_printed_rates_are_equations_28_and_29() -> None:
    rho, e2f, f, g, u, corr, l2f, gamma = 0.8, 0.1, -1.0, 0.5, 3.0, 0.7, 30.0, 2000.0
    rates = observer.copy_rates(rho, 0.4, 0.2, e2f, f, g, u, 0.6, corr, 20.0, l2f)
    assert rates == pytest.approx((0.4 + 0.6 + 20.0 * 0.2, f + g * rho * u + corr + l2f * e2f))
    assert observer.rho_rate(e2f, g, u, gamma) == pytest.approx(gamma * e2f * g * u)


def test_the_identified_system_of_27_differs_from_the_observer_in_rho_alone() -> None:
    f, g, u, corr = -1.0, 0.5, 3.0, 0.7
    _, copied = observer.copy_rates(0.8, 0.4, 0.0, 0.0, f, g, u, 0.0, corr, 20.0, 30.0)
    assert observer.faulty_rate(0.8, f, g, u, corr) == pytest.approx(copied)
    assert observer.faulty_rate(0.5, f, g, u, corr) == pytest.approx(copied - 0.3 * g * u)


def test_identifier_terms_inside_the_observer_absorb_the_fault() -> None:
    """Theory: with measured signals in place of (27) and the correction, ρ̂ stays wrong."""
    found = {}
    for corrected in (True, False):
        h, true, rho = 1e-4, 0.7, 1.0
        v = x2o = x2f = 0.0
        for k in range(40000):
            u = 3.0 * np.sin(3.0 * k * h) + 4.0
            f = -2.0 * v
            corr = 100.0 * (v - x2o)
            _, rate = observer.copy_rates(
                rho, x2f, 0.0, v - x2f, f, 1.0, u, 0.0, corr if corrected else 0.0, 30.0, 30.0
            )
            drho = observer.rho_rate(v - x2f, 1.0, u, 50.0)
            x2o += h * (f + u + corr)
            x2f += h * rate
            rho += h * drho
            v += h * (f + true * u)
        found[corrected] = rho
    assert found[False] == pytest.approx(0.7, abs=0.02)
    assert found[True] > 0.95


def test_residual_variance_adds_independent_causes() -> None:
    got = observer.residual_variance(
        0.3, 0.16, 2.0, 3.0, 0.5, -10.0, 0.05, 0.02, 0.5, 0.01, 0.4, 0.05
    )
    causes = [0.3, 0.16 * 2, 0.02 * 2 * 3, 0.5 * 2 * 0.5, 0.01 * 10, 0.4 * np.exp(-1.0)]
    assert got == pytest.approx(sum(c**2 for c in causes))
