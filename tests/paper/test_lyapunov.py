"""(15), (24), (30) along trajectories and at random states, and what breaks them.

The plants have ideal weights and meet every assumption (lyapunov_plant.py); the bounds are
derived in dftc_rt/paper/lyapunov.py. Along a trajectory V - ∫(what tanh adds at most) must not
rise; the stronger claim, that V also falls by -∫Σ k s² and its like, is tested with it.

The table of what each flipped sign does:  pytest -s tests/paper/test_lyapunov.py -k flipped
"""

import functools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dftc_rt.errors import InputError
from dftc_rt.paper import lyapunov
from tests.paper.lyapunov_plant import (
    BOUND_E,
    DELTA,
    DELTA_O,
    LOSS,
    LOSS_F,
    LOSS_O,
    RHO,
    SLACK,
    SLACK_O,
    W_F,
    W_FO,
    W_G,
    W_GO,
    X1,
    X1F,
    X1FO,
    X1O,
    X2,
    X2F,
    X2FO,
    X2O,
    XI,
    H,
    Motion,
    Plant,
    S,
    draw,
    parameters,
    solve,
)

EPSILON = 0.02
TOLERANCE = 1e-8
"""Of the solver, relative to V(0): LSODA runs with rtol 1e-9."""
GENTLE: dict[str, Any] = {
    "k": 1.0, "lam": 2.0, "gamma_f": 2.0, "gamma_g": 0.2, "gamma_delta": 2.0, "gamma_xi": 4.0,
    "l1": 2.0, "l2": 2.0, "gamma_fo": 2.0, "gamma_go": 0.5, "gamma_delta_o": 2.0,
    "gamma_rho": 4.0, "l1f": 1.0, "l2f": 1.0,
}  # fmt: skip
"""Little damping: what an adaptive law does shows in V."""
PLANTS = [(n, seed) for n in (2, 3) for seed in range(3)]
FLIPS = {
    "gamma_f": ("(11)", "15"),
    "gamma_g": ("(12)", "15"),
    "gamma_delta": ("(13)", "15"),
    "gamma_xi": ("(14)", "15"),
    "gamma_fo": ("(21)", "24"),
    "gamma_go": ("(22)", "24"),
    "gamma_delta_o": ("(23)", "24"),
    "gamma_rho": ("(29)", "30"),
}


def _rise(v: np.ndarray) -> float:
    """Largest rise of any column of v (K, …) above its least value so far."""
    return float((v - np.minimum.accumulate(v, axis=0)).max())


def _histories(plant: Plant, motion: Motion) -> dict[str, tuple[np.ndarray, ...]]:
    """V, loss and slack of (15), summed, and of (24), (30), joint by joint; (K, …) each."""
    z = motion.z
    delta_o = np.abs(motion.sig[:, H]).max(0)  # sup |h_i + ω_i|
    return {
        "15": (plant.tracking(z, motion.sig[:, S]).sum(1), z[..., LOSS].sum(1),
               z[..., SLACK].sum(1)),
        "24": (plant.identification(z, delta_o), z[..., LOSS_O], z[..., SLACK_O]),
        "30": (plant.estimation(z), z[..., LOSS_F], np.zeros_like(z[..., LOSS_F])),
    }  # fmt: skip


def _falls(v: np.ndarray, loss: np.ndarray, slack: np.ndarray) -> None:
    tolerance = TOLERANCE * max(1.0, float(np.max(v[0])))
    assert _rise(v - slack) <= tolerance
    assert _rise(v + loss - slack) <= tolerance


def _faulty(plant: Plant) -> Plant:
    """Every actuator weakened; ρ_i is part of what (27)-(29) have to find."""
    plant.rho = np.linspace(0.5, 0.8, plant.n)
    return plant


@pytest.mark.parametrize(("n", "seed"), PLANTS)
@pytest.mark.parametrize("epsilon", [EPSILON, 0.002])
def test_v_falls_but_for_what_the_smooth_sgn_adds(n: int, seed: int, epsilon: float) -> None:
    plant = draw(seed, n, epsilon, GENTLE)
    motion = solve(plant, 6.0 if epsilon == EPSILON else 1.0)
    assert motion.end == ""
    found = _histories(plant, motion)
    for name in ("15", "24"):
        _falls(*found[name])
    assert found["15"][0][-1] < found["15"][0][0]


def test_v_falls_with_the_printed_gains() -> None:
    plant = _faulty(draw(0, 2, EPSILON, {}))
    plant.z0[:, RHO] = 0.9
    healthy = draw(0, 2, EPSILON, {})
    for name, each in (("15", healthy), ("24", healthy), ("30", plant)):
        motion = solve(each, 1.5)
        assert motion.end == ""
        _falls(*_histories(each, motion)[name])


@pytest.mark.parametrize(("n", "seed"), PLANTS)
def test_v_of_the_observer_falls_whatever_the_identifier_has_learned(n: int, seed: int) -> None:
    """No sgn is left in it: no slack. ĝ_o is as drawn, wrong; V falls, and ρ̂ need not arrive."""
    plant = _faulty(draw(seed, n, EPSILON, GENTLE))
    found = _histories(plant, motion := solve(plant, 6.0))
    assert motion.end == ""
    _falls(*found["30"])
    assert (found["30"][0][-1] < found["30"][0][0]).all()


@pytest.mark.parametrize(("n", "seed"), PLANTS)
def test_a_constant_loss_without_the_gain_moves_the_ideal_weights_only(n: int, seed: int) -> None:
    """(15) with ρ W*_g for W*_g: the law as it is stands a constant loss."""
    plant = _faulty(draw(seed, n, EPSILON, GENTLE))
    motion = solve(plant, 6.0)
    assert motion.end == ""
    _falls(*_histories(plant, motion)["15"])


@pytest.mark.parametrize(("n", "seed"), PLANTS)
@pytest.mark.parametrize("flip", FLIPS)
def test_a_flipped_sign_of_one_adaptive_law_is_seen(flip: str, n: int, seed: int) -> None:
    label, name = FLIPS[flip]
    start, healthy, end = _outcome(name, flip if flip in ALONE else "", 1.0, n, seed)
    _, flipped, how = _outcome(name, flip, -1.0, n, seed)
    print(f"\n{label} n={n} seed={seed}: V of ({name}) {start:.3g} at first, rises by "
          f"{healthy:.1e}; flipped by {flipped:.2g} {how}")  # fmt: skip
    assert end == ""
    assert healthy <= TOLERANCE * max(1.0, start)
    assert flipped > 1e-3


ALONE = ("gamma_g", "gamma_go")
"""Seen well if the other network is right: what is left of s, or e_2o, is due to Ŵ_g, h and ω."""


@functools.cache
def _outcome(name: str, changed: str, sign: float, n: int, seed: int) -> tuple[float, float, str]:
    """V at the start, its largest rise beyond what tanh may add, and how the run ended."""
    plant = draw(seed, n, EPSILON, GENTLE)
    if name == "30":
        _faulty(plant)
    if changed in ALONE:
        plant.z0[:, W_F] = plant.z0[:, W_FO] = plant.w_f
    if changed:
        plant.run[changed] *= sign
    motion = solve(plant, 4.0)
    v, _, slack = _histories(plant, motion)[name]
    return float(np.max(v[0])), _rise(v - slack), motion.end


# at any state, with the exact sgn


def _derivative(
    plant: Plant, z: np.ndarray, delta_o: float, delta: Any = None
) -> dict[str, np.ndarray]:
    """V̇ by central differences along the flow, (n,) each; V is quadratic in all but s."""
    dz, _ = plant.rates(0.0, z)
    step = 1e-5
    ends = []
    for t in (-step, step):
        moved = z + t * dz
        s = plant.rates(t, moved)[1][S]
        ends.append(
            {
                "15": plant.tracking(moved, s, delta),
                "24": plant.identification(moved, delta_o),
                "30": plant.estimation(moved),
            }
        )
    return {name: (ends[1][name] - ends[0][name]) / (2.0 * step) for name in ends[0]}


def _any_state(seed: int, n: int, epsilon: float) -> Plant:
    rng = np.random.default_rng(seed)
    plant = draw(seed, n, epsilon, GENTLE)
    z = plant.z0
    z[:, [X1, X2, X1O, X2O, X1F, X2F, X1FO, X2FO]] = rng.uniform(-2.0, 2.0, (n, 8))
    z[:, [DELTA, XI, DELTA_O]] = rng.uniform(0.0, 2.0, (n, 3))
    z[:, RHO] = rng.uniform(0.1, 1.2, n)
    return plant


@settings(deadline=None, max_examples=60, derandomize=True)
@given(st.integers(0, 2**31), st.integers(1, 5))
def test_rates_at_any_state_with_the_exact_sgn(seed: int, n: int) -> None:
    plant = _any_state(seed, n, 0.0)
    dz, sig = plant.rates(0.0, plant.z0)
    v = _derivative(plant, plant.z0, float(np.abs(sig[H]).max()))
    slop = 1e-5 * (1.0 + float(np.abs(dz).max()))
    assert v["15"].sum() <= -dz[:, LOSS].sum() + slop
    assert (v["24"] <= -dz[:, LOSS_O] + slop).all()
    assert not dz[:, [SLACK, SLACK_O]].any()
    _faulty(plant)
    dz, _ = plant.rates(0.0, plant.z0)
    assert (_derivative(plant, plant.z0, 0.0)["30"] <= -dz[:, LOSS_F] + slop).all()


def test_smoothing_constant_is_the_largest_gap() -> None:
    s = np.linspace(-30.0, 30.0, 600001)
    gap = np.abs(s) - s * np.tanh(s / 0.7)
    assert gap.max() == pytest.approx(lyapunov.smoothing(0.7, np.ones(1))[0], rel=1e-7)
    assert lyapunov.smoothing(0.0, np.ones(1))[0] == 0.0
    assert 0.2784 < lyapunov.SMOOTHING < 0.2785


def test_what_is_not_adapted_has_no_lyapunov_function() -> None:
    par, zero = parameters(2, 0.0, gamma_f=0.0), np.zeros(2)
    with pytest.raises(InputError, match="gamma_f"):
        lyapunov.tracking(par, zero, np.zeros((2, 7)), np.zeros((2, 7)), zero, zero)


# what does not hold


def _ideal(n: int, d: np.ndarray, **gains: float) -> Plant:
    """Every adapted quantity ideal, cos(…) = 1 at t = 0, no ω, exact sgn; both joints upright."""
    plant = draw(0, n, 0.0, {**GENTLE, **gains})
    plant.d, plant.phase[:], plant.xi[:] = d, 0.0, 0.0
    plant.z0[:] = 0.0
    plant.z0[:, RHO] = plant.rho
    plant.z0[:, W_F] = plant.z0[:, W_FO] = plant.w_f
    plant.z0[:, W_G] = plant.z0[:, W_GO] = plant.w_g
    return plant


def _put_s(plant: Plant, s: list[float]) -> None:
    """Velocities that give s at t = 0."""
    _, sig = plant.rates(0.0, plant.z0)
    plant.z0[:, X2] += np.array(s) - sig[S]


def test_only_the_sum_of_15_falls() -> None:
    plant = _ideal(2, np.full((2, 2), 0.5))
    _put_s(plant, [0.1, 2.0])
    v = _derivative(plant, plant.z0, 0.0)["15"]
    # joint 1: -k s² + |s| (d S_1 + d S_2) - 2 d |s| S_1, with S = 1.11 and 7
    assert v[0] == pytest.approx(-0.01 + 0.1 * 0.5 * (1.11 + 7.0) - 0.1 * 1.11, rel=1e-6)
    assert v[0] > 0.2
    assert v.sum() < -5.0


def test_delta_of_the_row_alone_does_not_do() -> None:
    """δ_i = n max_j d_ij for each row i: Σ V_i rises; with the largest d of all rows it falls."""
    plant = _ideal(2, np.array([[1.0, 1.0], [0.0, 0.0]]), k=0.2)
    _put_s(plant, [1.0, 2.0])
    row, both = np.array([2.0, 0.0]), np.array([2.0, 2.0])
    # -k Σ s² + |s_1| (S_1 + S_2) - Σ δ_i |s_i| S_i, with S = 3 and 7
    v = _derivative(plant, plant.z0, 0.0, delta=row)["15"]
    assert v.sum() == pytest.approx(-0.2 * 5.0 + (3.0 + 7.0) - 2.0 * 3.0, rel=1e-6)
    v = _derivative(plant, plant.z0, 0.0, delta=both)["15"]
    assert v.sum() == pytest.approx(-0.2 * 5.0 + (3.0 + 7.0) - 2.0 * 3.0 - 2.0 * 2.0 * 7.0)


def test_smoothing_does_raise_v_and_the_less_the_narrower_the_layer() -> None:
    """The bound is not idle: V of (15) itself rises, by some of it."""
    rises = {}
    for epsilon in (0.02, 0.002):
        plant = draw(1, 2, epsilon, GENTLE)
        v, _, slack = _histories(plant, solve(plant, 2.0))["15"]
        rises[epsilon] = _rise(v)
        assert rises[epsilon] <= slack[-1]
    assert rises[0.02] > 1e-3
    assert rises[0.002] < 0.2 * rises[0.02]


def test_delta_of_the_tracking_proof_is_too_small_for_the_identifier() -> None:
    """|h| ≤ Σ d S bounds nothing in terms of E: V_io rises with δ_o = n max d."""
    plant = _ideal(2, np.full((2, 2), 0.2))
    plant.par["layer"] = plant.par["layer_o"] = plant.run["layer"] = plant.run["layer_o"] = 0.002
    _put_s(plant, [4.0, 4.0])
    plant.z0[:, X2O] = plant.z0[:, X2]
    motion = solve(plant, 1.0)
    small = plant.identification(motion.z, plant.delta) - motion.z[..., SLACK_O]
    _falls(*_histories(plant, motion)["24"])
    assert _rise(small) > 0.5 * small[0].max()
    assert np.abs(motion.sig[:, H]).max() > 10.0 * plant.delta


@pytest.mark.parametrize(("n", "seed"), PLANTS)
def test_with_an_interconnection_within_e_only_the_sum_of_24_falls(n: int, seed: int) -> None:
    plant = draw(seed, n, EPSILON, GENTLE, bounded_by=BOUND_E)
    motion = solve(plant, 6.0)
    v = plant.identification(motion.z, plant.delta + plant.xi)
    loss, slack = motion.z[..., LOSS_O].sum(1), motion.z[..., SLACK_O].sum(1)
    _falls(v.sum(1), loss, slack)


def test_of_24_one_joint_may_gain_where_the_interconnection_is_within_e() -> None:
    plant = _ideal(2, np.full((2, 2), 0.5))
    plant.bounded_by = BOUND_E
    plant.z0[:, X2O] = plant.z0[:, X2] - np.array([0.1, 2.0])
    v = _derivative(plant, plant.z0, plant.delta)["24"]
    assert v[0] > 0.2
    assert v.sum() < -5.0


def test_observer_gains_below_a_half_may_raise_30() -> None:
    """e_1f e_2f is what l_1f, l_2f have to outweigh: l_1f l_2f ≥ ¼ is what it takes."""
    rates = {}
    for l1f, l2f in ((0.4, 0.4), (0.5, 0.5), (0.3, 0.9)):
        plant = _ideal(1, np.zeros((1, 1)))
        plant.run["l1f"], plant.run["l2f"] = l1f, l2f
        plant.z0[:, X1FO], plant.z0[:, X2FO] = -1.0, -1.0
        rates[l1f] = float(_derivative(plant, plant.z0, 0.0)["30"][0])
    assert rates[0.4] == pytest.approx(0.2, abs=1e-6)
    assert rates[0.5] == pytest.approx(0.0, abs=1e-6)
    assert rates[0.3] < 0.0


def test_measured_signals_in_the_place_of_27_raise_30() -> None:
    """Nothing cancels then: f̂_o's error and the identifier's corrections drive e_f."""
    plant = _faulty(draw(0, 2, EPSILON, GENTLE, measured=True))
    motion = solve(plant, 6.0)
    assert _rise(plant.estimation(motion.z)) > 0.1
