"""Evidence of a loss, against what follows from its definition."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dftc_rt.benchmark import information

H = 1e-3


def test_a_filtered_step_rises_with_the_time_constant() -> None:
    out = information.filtered(np.ones(200), H)
    assert out[round(1 / information.BANDWIDTH / H) - 1] == pytest.approx(
        1 - math.exp(-1), abs=0.02
    )
    assert out[-1] == pytest.approx(1.0, abs=1e-6)


def test_what_is_delivered_comes_later_and_through_the_lag() -> None:
    command = np.ones((50, 2))
    delay = np.array([0, 3], dtype=np.int64)
    out = information.delivered_torque(command, H, delay, np.array([0.0, 0.002]))
    assert out[0, 0] == 0.0  # the command of a cycle acts from the next SYNC on
    assert out[1, 0] == 1.0
    assert np.flatnonzero(out[:, 1])[0] == 4
    assert 0.0 < out[4, 1] < 1.0


def test_evidence_of_a_constant_loss_grows_by_half_its_square_over_the_variance() -> None:
    missing, variance = np.full(2000, 3.0), 5.0
    found = information.evidence(missing, variance, H)
    slope = (found[-1] - found[-1001]) / 1000
    assert slope == pytest.approx(0.5 * 9.0 / 5.0, rel=1e-6)
    assert found[0] < 0.01  # the filter has not risen yet


def test_a_constant_torque_is_never_distinct() -> None:
    found = information.distinct_evidence(np.full(3000, -7.0), 1.0, H)
    assert found.max() < 1e-6


def test_of_a_whole_period_the_change_is_distinct_and_the_mean_is_not() -> None:
    t = np.arange(8000) * H
    missing = 4.0 + 2.0 * np.cos(2 * np.pi * 0.5 * t)
    found = information.distinct_evidence(missing, 1.0, H)
    share = information.BANDWIDTH / math.hypot(information.BANDWIDTH, np.pi)
    assert found[-1] == pytest.approx(0.5 * 0.5 * (2.0 * share) ** 2 * 8000, rel=0.02)
    assert np.all(np.diff(found) >= 0.0)


def test_the_time_at_which_a_threshold_is_reached() -> None:
    t, values = np.array([0.0, 1.0, 2.0]), np.array([0.5, 1.5, 4.0])
    assert information.time_passed(t, values, 1.5) == 1.0
    assert information.time_passed(t, values, 1.6) == 2.0
    assert information.time_passed(t, values, 5.0) is None
