"""Delays that never end, and the interval of a rate."""

from __future__ import annotations

import math

import pytest

from dftc_rt.benchmark import statistics


def test_delays_that_never_end_are_the_longest() -> None:
    found = statistics.delays([0.3, None, 0.1, 0.2])
    assert (found.n, found.never) == (4, 1)
    assert found.median == 0.2  # two of four are not longer
    assert found.most == math.inf
    assert found.largest == 0.3


def test_the_95th_percentile_needs_19_of_20() -> None:
    values: list[float | None] = [0.01 * k for k in range(1, 20)]
    assert statistics.delays([*values, None]).most == pytest.approx(0.19)
    assert statistics.delays([*values[:18], None, None]).most == math.inf


def test_no_delays_at_all() -> None:
    found = statistics.delays([])
    assert found.n == 0
    assert math.isnan(found.median)
    assert math.isnan(found.largest)


def test_pooled_is_the_root_of_the_mean_square() -> None:
    assert statistics.pooled([3.0, None, 4.0]) == pytest.approx(math.sqrt(12.5))
    assert math.isnan(statistics.pooled([None]))


# Exact limits of a Poisson mean, 95 % two-sided: E. S. Pearson, H. O. Hartley, Biometrika Tables
# for Statisticians 1 (1954), table 40.
@pytest.mark.parametrize(
    ("count", "low", "high"),
    [(0, 0.0, 3.69), (1, 0.0253, 5.57), (5, 1.62, 11.67), (10, 4.80, 18.39), (20, 12.22, 30.89)],
)
def test_interval_of_a_rate(count: int, low: float, high: float) -> None:
    assert statistics.poisson_interval(count, 1.0) == pytest.approx((low, high), abs=0.006)
    assert statistics.poisson_interval(count, 4.0) == pytest.approx((low / 4, high / 4), abs=0.002)


def test_a_rate_of_nothing_may_be_anything() -> None:
    assert statistics.poisson_interval(0, 0.0) == (0.0, math.inf)


def test_median_and_largest_leave_out_what_is_not_there() -> None:
    assert statistics.median([None, 1.0, 3.0]) == 2.0
    assert statistics.largest([None, 1.0, 3.0]) == 3.0
    assert statistics.quantile([0.0, 1.0, None], 0.25) == 0.25
    assert math.isnan(statistics.median([]))
