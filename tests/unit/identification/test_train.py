"""Networks of known weights are found again, in the law's own units."""

import numpy as np
from scipy.signal import lfilter

from dftc_rt.control.basis import grid_centres
from dftc_rt.identification.regressors import Basis, Samples, columns
from dftc_rt.identification.train import Grid, train

H, ALPHA, LIMIT = 1e-3, 0.077, 40.0


def _grid() -> Grid:
    one = np.ones(1)
    centres = grid_centres(-one, one, 2 * one, 5, 5)[0]
    return Grid(Basis(centres, 2.0, 1.0), (-1.0, 1.0), 2.0, (5, 5))


def _run(seed: int, grid: Grid, w_fo: np.ndarray, offset: float = 0.0) -> Samples:
    rng = np.random.default_rng(seed)
    t = np.arange(20_000) * H
    q, v = np.zeros((2, t.size))
    for omega in rng.uniform(1.0, 4.0, 3):
        phase = rng.uniform(0, 6)
        q += 0.25 * np.sin(omega * t + phase)
        v += 0.25 * omega * np.cos(omega * t + phase)
    inertia = 2.0 + 0.5 * np.sin(t)
    phi_f = lfilter([ALPHA], [1, ALPHA - 1], 10 * np.sin(2 * t + seed))
    exact = Samples(q, v, inertia, phi_f, phi_f, ALPHA)
    table, _ = columns(exact, grid.basis, 0, 1)
    noise = lfilter([ALPHA], [1, ALPHA - 1], rng.normal(0, 0.2, t.size))
    return Samples(
        q, v, inertia, phi_f + table[:, : w_fo.size] @ w_fo + noise + offset, phi_f, ALPHA
    )


def test_known_networks_are_found() -> None:
    grid = _grid()
    true = np.random.default_rng(1).normal(0, 1.0, 25)
    found = train([_run(seed, grid, true) for seed in range(4)], grid, LIMIT, H, 1.0)
    other = _run(99, grid, true)
    table, residual = columns(other, grid.basis, 1000, 10)
    left = residual - table @ np.concatenate([found.w_fo, found.w_go])
    assert np.sqrt(np.mean(left**2)) < 0.15 * np.sqrt(np.mean(residual**2))
    assert np.all(found.w_fo[~found.visited] == 0.0)
    assert 0.0 < found.q_seen < 1.0
    assert 0.0 < found.v_seen < 1.0
    assert found.choice.left_out < 0.2


def test_a_residual_of_its_own_in_every_run_is_not_learned() -> None:
    grid = _grid()
    runs = [_run(seed, grid, np.zeros(25), 0.8 * (-1) ** seed) for seed in range(4)]
    found = train(runs, grid, LIMIT, H, 1.0)
    assert np.all(found.w_fo == 0.0)
    assert np.all(found.w_go == 0.0)
    assert np.isinf(found.choice.strength)
