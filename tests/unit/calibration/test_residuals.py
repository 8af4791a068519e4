"""Variance, colour and tails of residuals that were drawn from known distributions."""

import numpy as np
import pytest
from scipy.signal import lfilter

from dftc_rt.calibration import thresholds
from dftc_rt.calibration.residuals import colour, spread, velocity_noise

H = 1e-3


def _ar1(time_constant: float, size: int, seed: int = 0) -> np.ndarray:
    """Unit-variance noise with a stated correlation time."""
    pole = np.exp(-H / time_constant)
    white = np.random.default_rng(seed).normal(0, np.sqrt(1 - pole**2), size)
    return np.asarray(lfilter([1], [1, -pole], white))


def test_colour_is_the_sum_of_the_autocorrelation() -> None:
    pole = np.exp(-H / 0.05)
    exact = (1 + pole) / (1 - pole)  # 1 + 2 Σ pole^k
    assert colour(_ar1(0.05, 400_000), H) == pytest.approx(exact, rel=0.15)
    assert colour(np.random.default_rng(0).normal(size=100_000), H) == 10.0  # its least


def test_variance_follows_its_causes() -> None:
    rng = np.random.default_rng(2)
    size = 60_000
    t = np.arange(size) * H
    v, acc, bias = np.sin(0.7 * t), 3 * np.sin(1.3 * t), 20 * np.cos(0.4 * t)
    inertia = np.full(size, 2.0)
    std = np.sqrt(0.1**2 + (0.05 * inertia * acc) ** 2 + 0.6**2 * np.exp(-((v / 0.1) ** 2)))
    residual = std * _ar1(0.01, size, 3)
    measured = v + rng.normal(0, 1e-4, size)
    found = spread(residual, inertia, bias, acc, measured, 80.0, H, 1e-3)
    assert found.floor_nm == pytest.approx(0.11, rel=0.3)
    assert found.sigma_acc == pytest.approx(0.055, rel=0.25)
    assert found.sigma_bias < 0.005
    assert found.friction_nm == pytest.approx(0.66, rel=0.25)
    assert found.v_friction == pytest.approx(0.1 * np.sqrt(2))
    assert found.velocity_noise == pytest.approx(1e-4, rel=0.05)
    assert found.inflation == pytest.approx(20, rel=0.4)


def test_the_floor_has_a_least_value() -> None:
    quiet = 1e-6 * np.random.default_rng(0).normal(size=5000)
    ones = np.ones(5000)
    assert spread(quiet, ones, ones, ones, 0 * ones, 80.0, H, 0.25).floor_nm == 0.25


def test_velocity_noise_ignores_the_motion() -> None:
    t = np.arange(20_000) * H
    noise = np.random.default_rng(1).normal(0, 0.002, t.size)
    assert velocity_noise(2 * np.sin(6 * t) + noise) == pytest.approx(0.002, rel=0.03)


def test_threshold_extrapolates_an_exponential_tail() -> None:
    maxima = np.random.default_rng(4).exponential(2.0, 3600)
    for rate in (100.0, 1.0, 0.01):
        wanted = 2.0 * np.log(3600.0 / (rate * thresholds.BLOCK_S))
        assert thresholds.threshold(maxima, rate) == pytest.approx(wanted, rel=0.1)


def test_threshold_of_silence_is_that_of_a_likelihood_ratio() -> None:
    assert thresholds.threshold(np.zeros(60), 0.1) == pytest.approx(np.log(0.3 * 36000), rel=1e-9)


def test_block_maxima_leave_out_a_rest() -> None:
    values = np.arange(2500.0)
    np.testing.assert_array_equal(thresholds.block_maxima(values, H), [999, 1999])
