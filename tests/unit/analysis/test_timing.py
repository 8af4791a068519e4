"""Percentiles against a list that can be counted off."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.analysis.timing import percentiles_us, period_s


def test_percentiles_of_a_counted_list() -> None:
    seconds = np.arange(1001) * 1e-6
    found = percentiles_us(np.append(seconds[::-1], np.nan))
    assert found == {
        "p50": pytest.approx(500.0),
        "p99": pytest.approx(990.0),
        "p999": pytest.approx(999.0),
        "max": pytest.approx(1000.0),
    }


def test_nothing_has_no_percentiles() -> None:
    assert percentiles_us(np.array([np.nan])) == dict.fromkeys(("p50", "p99", "p999", "max"))


def test_period_is_not_moved_by_skipped_ticks() -> None:
    assert period_s(np.array([0.0, 0.001, 0.002, 0.008, 0.009])) == pytest.approx(0.001)
    assert period_s(np.array([0.0])) == 0.0
