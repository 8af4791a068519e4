"""The self-tuned gain (33) and the command as the drive is told."""

import math

import pytest

from dftc_rt.control import gain


@pytest.mark.parametrize(("rho", "expected"), [(0.5, 2.0), (1.0, 1.0), (1.2, 1.0), (0.01, 4.0)])
def test_target_is_equation_33_on_a_clipped_estimate(rho: float, expected: float) -> None:
    assert gain.target(rho, 0.25, 1.0) == pytest.approx(expected)


def test_gain_moves_at_a_bounded_rate() -> None:
    assert gain.follow(1.0, 2.0, 20.0, 0.001) == pytest.approx(1.02)
    assert gain.follow(2.0, 1.0, 20.0, 0.001) == pytest.approx(1.98)
    assert gain.follow(1.0, 1.001, 20.0, 0.001) == pytest.approx(1.001)
    assert gain.follow(1.0, 2.0, math.inf, 0.001) == 2.0


def test_command_is_saturated_and_a_whole_number_of_steps() -> None:
    assert gain.command(5.013, 1.0, 30, 0.1, 3.05) == pytest.approx(3.0)
    assert gain.command(-5.0, 2.0, 30, 0.1, 3.05) == pytest.approx(-3.0)
    assert gain.command(1.26, 1.0, 30, 0.1, 3.05) == pytest.approx(1.3)
    assert gain.command(1.0, 1.5, 30, 0.1, 3.05) == pytest.approx(1.5)
    assert gain.command(1.26, 1.0, 0, 0.0, 3.05) == 1.26
    assert gain.command(9.0, 1.0, 0, 0.0, 3.05) == 3.05
    assert abs(gain.command(1e300, 1.0, 30, 0.1, 3.05)) <= 3.05


def test_the_printed_gain_is_not_clipped_at_one() -> None:
    assert gain.target(1.25, 0.01, math.inf) == pytest.approx(0.8)
