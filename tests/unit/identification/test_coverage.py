"""Cells of a grid that a motion visited."""

import numpy as np

from dftc_rt.identification.coverage import LEAST_S, time_in_cells, visited


def test_time_goes_to_the_nearest_point() -> None:
    q = np.array([-1.0, -0.4, 0.1, 0.9, 0.9, 1.4, 1.6])  # points at -1, 0, 1: 1.6 is outside
    v = np.array([-2.0, 0.9, 0.0, 2.0, -1.1, 0.0, 0.0])  # points at -2, 0, 2
    times = time_in_cells(q, v, (-1.0, 1.0), 2.0, (3, 3), 0.5)
    expected = np.zeros((3, 3))
    expected[0, 0] = 0.5  # (-1, -2)
    expected[1, 1] = 1.0  # (-0.4, 0.9), (0.1, 0)
    expected[2, 2] = 0.5  # (0.9, 2)
    expected[2, 0] = 0.5  # (0.9, -1.1)
    expected[2, 1] = 0.5  # (1.4, 0)
    np.testing.assert_array_equal(times.reshape(3, 3), expected)


def test_one_point_stands_for_the_whole_range() -> None:
    q = np.array([-0.9, 0.9, 1.1])
    times = time_in_cells(q, np.zeros(3), (-1.0, 1.0), 1.0, (1, 3), 1.0)
    np.testing.assert_array_equal(times, [0.0, 2.0, 0.0])


def test_a_cell_counts_from_a_least_time_on() -> None:
    short, enough = 0.4 * LEAST_S, 0.6 * LEAST_S
    times = [np.array([0.0, short, enough]), np.array([0.0, short, enough])]
    np.testing.assert_array_equal(visited(times), [False, False, True])
