"""The identifier against (18), and convergence on a plant it can represent."""

import pytest

from dftc_rt.control import identifier, law


def test_right_hand_sides_are_equation_18() -> None:
    x1, x2, x1o, x2o, l1, l2, delta, f, g, u = 0.4, -0.2, 0.1, 0.3, 40.0, 100.0, 0.5, 1.1, 0.7, 2.0
    e1, e2 = x1 - x1o, x2 - x2o
    big_e = 1 + abs(e2) + e2**2
    corr = identifier.correction(delta, big_e, -1.0, l2, e2)
    assert corr == pytest.approx(delta * -1.0 * big_e + l2 * e2)
    assert identifier.rate1(x2o, l1, e1) == pytest.approx(x2o + l1 * e1)
    assert identifier.rate2(f, g, u, corr) == pytest.approx(
        f + g * u + delta * -1.0 * big_e + l2 * e2
    )


def test_state_converges_to_the_plant() -> None:
    """With f, g exact, the errors of (18) decay; a wrong sign of a correction diverges."""
    x1 = x2 = 0.0
    x1o, x2o, h = -1.0, 1.0, 1e-4
    for k in range(30000):
        u = 1.0 if k % 2000 < 1000 else -1.0
        f, g = -x1, 0.5
        e1, e2 = x1 - x1o, x2 - x2o
        sgn = law.switching(e2, 0.01, law.SAT)
        corr = identifier.correction(0.1, law.interconnection_bound(e2, 10.0), sgn, 100.0, e2)
        x1o += h * identifier.rate1(x2o, 40.0, e1)
        x2o += h * identifier.rate2(f, g, u, corr)
        x1 += h * x2
        x2 += h * (f + g * u)
    assert abs(x1 - x1o) < 1e-4
    assert abs(x2 - x2o) < 1e-4
