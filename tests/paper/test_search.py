"""The search over readings: its criteria, its integrators, and the verdicts of a few readings."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from dftc_rt.paper import search_criteria as criteria
from dftc_rt.paper.closed_loop import ClosedLoop
from dftc_rt.paper.observers import READINGS
from dftc_rt.paper.search import Row, columns, judge, search, summary, table, to_json
from dftc_rt.paper.search_integrators import Integrator, integrate
from dftc_rt.paper.search_space import QUICK, Candidate, space

TIMES = np.linspace(0.0, 9.0, 4501)
MILD = {"gamma_delta": 0.0, "gamma_xi": 0.0, "gamma_delta_o": 0.0, "gamma_go": 0.002,
        "g_min": 1.0, "g_max": 1.0}  # fmt: skip


def sine(amplitude: float) -> np.ndarray:
    return amplitude * np.sin(3.0 * TIMES)


def test_a_joint_that_wanders_off_cannot_follow() -> None:
    lost, small = criteria.rms(sine(0.3)), criteria.rms(sine(0.01))
    assert criteria.tracks(small)
    assert criteria.cannot_follow(lost, small)
    assert not criteria.tracks(lost)


def test_a_joint_that_gets_a_little_worse_follows() -> None:
    """A hundred times the error, but under 50 mrad: 3 mrad stay 3 mrad on a plot."""
    assert not criteria.cannot_follow(criteria.rms(sine(3e-3)), criteria.rms(sine(3e-5)))


def test_a_joint_that_was_lost_before_is_not_lost_to_the_fault() -> None:
    assert not criteria.cannot_follow(criteria.rms(sine(0.9)), criteria.rms(sine(0.5)))


def test_a_joint_that_left_cannot_follow_and_one_not_simulated_says_nothing() -> None:
    assert criteria.rms(np.array([0.1, np.inf])) == math.inf
    assert criteria.rms(np.array([0.1, 1e200])) == math.inf
    assert criteria.cannot_follow(math.inf, 1e-3)
    assert not criteria.cannot_follow(math.inf, math.inf)
    nothing = criteria.rms(np.array([]))
    assert math.isnan(nothing)
    assert not criteria.cannot_follow(nothing, 1e-3)
    assert not criteria.tracks(nothing)
    assert not criteria.follows(nothing)


def test_an_estimate_that_follows_and_one_that_stays_at_one() -> None:
    """ρ as in Example 1: staying at 1, or at its mean, is not following."""
    rho = 0.8 + 0.2 * np.cos(3.0 * TIMES)
    assert criteria.follows(criteria.rms(rho + 0.04 - rho))
    assert not criteria.follows(criteria.rms(1.0 - rho))
    assert not criteria.follows(criteria.rms(0.8 - rho))


@pytest.mark.parametrize(
    ("how", "tolerance"),
    [
        (Integrator("euler", 1e-5), 2e-4),
        (Integrator("rk4", 1e-3), 1e-6),
        (Integrator("ode45"), 5e-3),
    ],
    ids=str,
)
def test_integrators_agree_where_nothing_is_stiff(how: Integrator, tolerance: float) -> None:
    """Against Radau, on the printed law without δ̂, ξ̂ and with ĝ = 1."""
    candidate = Candidate(2, "test", "mild", gains=MILD)
    found = []
    for each in (Integrator(), how):
        loop = ClosedLoop(candidate.variant("none", False), READINGS[:2])
        found.append(integrate(loop, each, 0.0, 1.0, loop.initial()))
    exact, other = found
    assert exact.status == other.status == "done"
    np.testing.assert_allclose(other.t, exact.t, atol=1e-9)
    np.testing.assert_allclose(other.q, exact.q, atol=max(tolerance, 5e-5))
    assert other.t[-1] == pytest.approx(1.0)


def test_fixed_step_integrators_have_their_order() -> None:
    """Error of q(0.2 s) against a much finer step: ratio 2 for Euler, 16 for RK4."""

    def end(kind: str, step: float) -> np.ndarray:
        loop = ClosedLoop(
            Candidate(2, "test", "mild", gains=MILD).variant("none", False), READINGS[:2]
        )
        return integrate(loop, Integrator(kind, step), 0.0, 0.2, loop.initial()).q[-1]

    exact = end("rk4", 5e-5)
    for kind, ratio in (("euler", 2.0), ("rk4", 16.0)):
        coarse = np.abs(end(kind, 1e-3) - exact).max()
        fine = np.abs(end(kind, 5e-4) - exact).max()
        assert coarse / fine == pytest.approx(ratio, rel=0.35)


def test_what_leaves_and_what_takes_too_long() -> None:
    wild = Candidate(2, "test", "wild", integrator=Integrator("euler", 1e-2), epsilon=0.0)
    assert judge(wild).status.startswith("escaped before the fault, at 0.")
    short = Candidate(2, "test", "short", integrator=Integrator(evaluations=50))
    row = judge(short)
    assert row.status.startswith("gave up before the fault, at 0")
    assert math.isnan(row.healthy_rad)
    assert not row.tracks


def test_candidates_are_told_apart_and_the_draws_are_seeded() -> None:
    every = space()
    assert len({(c.example, c.name) for c in every}) == len(every)
    assert [c.name for c in every] == [c.name for c in space()]
    assert {c.name for c in space(quick=True)} == set(QUICK)


@pytest.fixture(scope="module")
def quick() -> dict[str, Row]:
    told: list[tuple[int, int]] = []
    rows = search(lambda done, of, name: told.append((done, of)), quick=True)
    assert told == [(k + 1, len(QUICK)) for k in range(len(QUICK))]
    return {row.reading: row for row in rows}


def test_as_printed_the_fault_is_hidden_and_the_estimate_stays_at_one(
    quick: dict[str, Row],
) -> None:
    row = quick["as printed"]
    assert row.status == "done"
    assert row.tracks
    assert not row.cannot_follow
    assert row.rho_true
    assert row.rho_true_rmse < 1e-3
    assert not row.rho_measured
    assert row.rho_measured_rmse == pytest.approx(0.2, abs=0.02)


def test_an_explicit_step_diverges(quick: dict[str, Row]) -> None:
    row = quick["Euler 0.001 s, exact sgn"]
    assert row.status.startswith("escaped before the fault")
    assert not row.tracks


def test_what_is_removed_is_lost_without_the_fault_as_well(quick: dict[str, Row]) -> None:
    row = quick["δ̂, ξ̂, Ŵ removed at the fault"]
    assert row.after_rad > criteria.LOST_RAD
    assert not row.tracks
    assert not row.needs_gain


def test_without_its_robust_terms_the_law_does_not_track(quick: dict[str, Row]) -> None:
    assert not quick["Γ_δ, Γ_ξ = 0, Γ_f, Γ_g = 500, g_i known"].tracks


def test_a_controller_that_knows_its_plant_needs_the_gain(quick: dict[str, Row]) -> None:
    """Nothing is left to hide the fault: 6, 7 and 10 hold; on measured signals 9 does not."""
    row = quick["f_i, g_i, h_i known, Γ_δ, Γ_ξ = 0"]
    assert row.needs_gain
    assert row.rho_true
    assert not row.rho_measured


def test_table_summary_json_and_csv(quick: dict[str, Row]) -> None:
    rows = list(quick.values())
    lines = table(rows).splitlines()
    assert len(lines) == 2 + len(rows)
    assert len({line.replace("\\|", "").count("|") for line in lines}) == 1
    parsed = json.loads(to_json(rows))
    assert [each["reading"] for each in parsed] == [row.reading for row in rows]
    assert parsed[1]["healthy_rad"] == "inf"
    assert parsed[1]["bare_rad"] is None
    assert list(parsed[0]) == columns()
    header = next(csv.reader(io.StringIO(",".join(columns()))))
    assert header[0] == "example"


def test_summary_counts_what_needs_the_gain(quick: dict[str, Row]) -> None:
    row = quick["as printed"]
    assert "Figures 6, 7 and 10: none of 1 readings." in summary([row])
    shown = replace(row, cannot_follow=True)
    assert "Figures 6, 7 and 10: 1 of 1 readings: as printed." in summary([shown])
    helpless = replace(row, cannot_follow=True, regains=False)
    assert "Figures 6, 7 and 10: none of 1 readings." in summary([helpless])
    assert "Figures 6 and 7, not regained with the gain: 1 of 1 readings: as printed." in summary(
        [helpless]
    )
