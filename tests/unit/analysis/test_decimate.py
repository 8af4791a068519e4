"""Thinned curves keep their peaks."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dftc_rt.analysis.decimate import extremes


@given(
    values=st.lists(st.floats(-1e6, 1e6) | st.just(float("nan")), max_size=400),
    points=st.integers(2, 60),
)
def test_extremes_and_ends_survive(values: list[float], points: int) -> None:
    array = np.array(values)
    kept = extremes(array, points)
    assert (np.diff(kept) > 0).all()
    assert len(kept) <= max(points, 0) + 2
    if len(array):
        assert (kept[0], kept[-1]) == (0, len(array) - 1)
        if np.isfinite(array).any():
            assert np.nanmax(array[kept]) == np.nanmax(array)
            assert np.nanmin(array[kept]) == np.nanmin(array)
