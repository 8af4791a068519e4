"""Basis and networks against the printed formula in NumPy."""

import numpy as np

from dftc_rt.control import basis


def test_diagonal_centres_are_the_papers() -> None:
    centres = basis.diagonal_centres(2)
    assert centres.shape == (2, 7, 2)
    for joint in centres:
        assert [tuple(c) for c in joint] == [(c, c) for c in (-3, -2, -1, 0, 1, 2, 3)]


def test_grid_covers_each_joints_own_range() -> None:
    lower, upper, speed = np.array([-1.0, 0.0]), np.array([1.0, 4.0]), np.array([2.0, 3.0])
    centres = basis.grid_centres(lower, upper, speed, 3, 5)
    assert centres.shape == (2, 15, 2)
    assert sorted(set(centres[1, :, 0])) == [0.0, 2.0, 4.0]
    assert sorted(set(centres[1, :, 1])) == [-3.0, -1.5, 0.0, 1.5, 3.0]
    assert len({tuple(c) for c in centres[0]}) == 15


def test_one_grid_point_stands_in_the_middle() -> None:
    centres = basis.grid_centres(np.array([0.0]), np.array([4.0]), np.array([1.0]), 1, 1)
    assert centres.tolist() == [[[2.0, 0.0]]]


def test_gaussian_is_the_papers() -> None:
    centres = basis.diagonal_centres(1)[0]
    x, b = np.array([0.3, -0.8]), 0.5
    out = np.empty(7)
    basis.gaussian(x[0], x[1], centres, 1 / b, 1 / b, out)
    expected = np.exp(-(np.linalg.norm(x - centres, axis=1) ** 2) / (2 * b**2))
    np.testing.assert_allclose(out, expected, rtol=1e-14)


def test_network_is_the_inner_product() -> None:
    rng = np.random.default_rng(1)
    w, sigma = rng.normal(size=9), rng.uniform(size=9)
    np.testing.assert_allclose(basis.network(w, sigma), w @ sigma, rtol=1e-14)


def test_adaptation_is_an_euler_step_with_leakage_and_projection() -> None:
    rng = np.random.default_rng(2)
    w, sigma = rng.normal(size=9), rng.uniform(size=9)
    expected = np.clip(w + 0.01 * (3.0 * sigma - 0.5 * w), -1.0, 1.0)
    basis.adapt(w, sigma, 3.0, 0.5, 1.0, 0.01)
    np.testing.assert_allclose(w, expected, rtol=1e-14)
    assert np.abs(w).max() == 1.0
