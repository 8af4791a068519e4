"""What transfers is learned; what does not is not, and cells without data stay at 0."""

import numpy as np
import pytest

from dftc_rt.identification.ridge import Fold, choose

ROWS, HALF = 400, 6


def _fold(seed: int, weights: np.ndarray, noise: float) -> Fold:
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(ROWS, 2 * HALF))
    return Fold.of(table, table @ weights + noise * rng.normal(size=ROWS))


def test_weights_common_to_all_runs_are_found() -> None:
    true = np.random.default_rng(0).normal(size=2 * HALF)
    folds = [_fold(seed, true, 0.1) for seed in range(1, 5)]
    found = choose(folds, np.ones(2 * HALF, dtype=bool))
    np.testing.assert_allclose(found.weights, true, atol=0.03)
    assert found.with_gain
    assert found.left_out == pytest.approx(0.1 / np.sqrt(true @ true + 0.01), rel=0.1)


def test_the_gain_network_is_left_out_when_it_has_no_part() -> None:
    true = np.concatenate([np.ones(HALF), np.zeros(HALF)])
    found = choose([_fold(seed, true, 0.5) for seed in range(4)], np.ones(2 * HALF, dtype=bool))
    assert not found.with_gain
    assert np.all(found.weights[HALF:] == 0.0)


def test_what_differs_from_run_to_run_is_not_learned() -> None:
    weights = np.random.default_rng(7).normal(size=2 * HALF)
    folds = [_fold(seed, (-1) ** seed * weights, 0.1) for seed in range(4)]
    found = choose(folds, np.ones(2 * HALF, dtype=bool))
    assert np.all(found.weights == 0.0)
    assert np.isinf(found.strength)
    assert found.left_out == 1.0


def test_a_cell_that_was_not_visited_keeps_weight_zero() -> None:
    use = np.ones(2 * HALF, dtype=bool)
    use[[2, HALF + 2]] = False
    found = choose([_fold(seed, np.ones(2 * HALF), 0.1) for seed in range(3)], use)
    assert np.all(found.weights[~use] == 0.0)
    assert np.all(found.weights[use] > 0.5)


def test_nothing_to_learn_from_gives_nothing() -> None:
    true = np.ones(2 * HALF)
    use = np.ones(2 * HALF, dtype=bool)
    assert np.all(choose([_fold(1, true, 0.1)], use).weights == 0.0)  # nothing to leave out
    assert np.all(choose([_fold(1, true, 0.1)] * 2, ~use).weights == 0.0)
    still = Fold.of(np.zeros((ROWS, 2 * HALF)), np.zeros(ROWS))
    assert np.all(choose([still, still], use).weights == 0.0)


def test_the_error_is_the_sum_of_squares() -> None:
    rng = np.random.default_rng(2)
    table, right, weights = rng.normal(size=(30, 4)), rng.normal(size=30), rng.normal(size=4)
    direct = float(np.sum((right - table @ weights) ** 2))
    assert Fold.of(table, right).error(weights) == pytest.approx(direct)
