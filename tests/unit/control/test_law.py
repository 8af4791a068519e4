"""The law against (4), (10), (13), (14) written out."""

import math

import numpy as np
import pytest

from dftc_rt.control import law


def test_sliding_variable() -> None:
    assert law.sliding(5.0, 0.2, -0.3) == pytest.approx(5.0 * 0.2 - 0.3)


@pytest.mark.parametrize("s", [-2.0, -0.1, 0.0, 0.4])
def test_interconnection_bound(s: float) -> None:
    assert law.interconnection_bound(s, math.inf) == pytest.approx(1 + abs(s) + s**2)
    assert law.interconnection_bound(s, 1.2) <= 1.2


@pytest.mark.parametrize("s", [-2.0, -0.1, 0.0, 0.1, 2.0])
def test_switching_is_sgn_sat_or_tanh(s: float) -> None:
    assert law.switching(s, 0.0, law.SAT) == np.sign(s)
    assert law.switching(s, 0.5, law.SAT) == pytest.approx(np.clip(s / 0.5, -1, 1))
    assert law.switching(s, 0.5, law.TANH) == pytest.approx(np.tanh(s / 0.5))


def test_dead_zone() -> None:
    assert law.magnitude(-0.5, 0.0) == 0.5
    assert law.magnitude(-0.5, 0.2) == pytest.approx(0.3)
    assert law.magnitude(0.1, 0.2) == 0.0


def test_law_is_equation_10() -> None:
    k, lam, e1, e2, acc, f, g, delta, xi = 10.0, 5.0, 0.1, -0.3, 0.7, -2.0, 0.4, 0.6, 0.3
    s = lam * e1 + e2
    big_s = 1 + abs(s) + s * s
    sgn = np.sign(s)
    expected = -(k * s + f + delta * sgn * big_s - acc + lam * e2 + xi * sgn) / g
    robust = law.robust_term(delta, xi, big_s, sgn)
    assert law.torque(k, lam, s, e2, acc, f, g, robust) == pytest.approx(expected, rel=1e-13)


def test_law_makes_s_decay_at_rate_k() -> None:
    """On x2' = f + g u the law (10) without robust terms gives s' = -k s exactly."""
    k, lam, e1, e2, acc, f, g = 10.0, 5.0, 0.1, -0.3, 0.7, -2.0, 0.4
    s = lam * e1 + e2
    u = law.torque(k, lam, s, e2, acc, f, g, 0.0)
    rate = lam * e2 + (f + g * u - acc)
    assert rate == pytest.approx(-k * s)


def test_bounds_only_grow_as_printed_and_leak_when_asked() -> None:
    assert law.bound_step(1.0, 4.0, 0.0, math.inf, 0.1) == pytest.approx(1.4)
    assert law.bound_step(1.0, 0.0, 2.0, math.inf, 0.1) == pytest.approx(0.8)
    assert law.bound_step(1.0, 100.0, 0.0, 1.5, 0.1) == 1.5
    assert law.bound_step(0.1, 0.0, 100.0, 1.5, 0.1) == 0.0


def test_split_models_are_equation_36() -> None:
    m, bias = 2.0, 3.0
    assert law.drift(m, bias, 0.25) == pytest.approx(-bias / m + 0.25)
    assert law.input_gain(m, 0.1, 0.5, 2.0) == pytest.approx(1.1 / m)
    assert law.input_gain(m, -5.0, 0.5, 2.0) == pytest.approx(0.5 / m)
    assert law.input_gain(m, 5.0, 0.5, 2.0) == pytest.approx(2.0 / m)
