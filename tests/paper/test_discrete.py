"""What the law needs to run at a fixed rate, and that the loop runs the shipped law."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dftc_rt.config.scenario import ReferenceTable
from dftc_rt.control import laws
from dftc_rt.control.signals import AD, NAMES, QD, TAU_CMD, VD, Q, V
from dftc_rt.dynamics.closed_form.local_terms import ClosedFormTerms
from dftc_rt.dynamics.closed_form.plants import CLOSED_FORMS
from dftc_rt.paper import discrete, discrete_loop
from dftc_rt.paper.discrete import Row, run
from dftc_rt.paper.discrete_cases import FIVE, FURTHER, PAIRS, Case, cases, complete, scales
from dftc_rt.paper.discrete_table import cell, needed, table
from dftc_rt.paper.examples import EXAMPLES, Q0
from dftc_rt.reference import Reference

QUICK = cases(quick=True)


@cache
def _row(index: int) -> Row:
    return run(QUICK[index])[0]


def _rows(group: str, number: int, scope: str) -> list[Row]:
    return [
        _row(k)
        for k, case in enumerate(QUICK)
        if (case.group, case.example, case.scope) == (group, number, scope)
    ]


BOTH = pytest.mark.parametrize("number", [1, 2])
SCOPES = pytest.mark.parametrize("scope", ["controller", "whole"])


@BOTH
@SCOPES
@pytest.mark.parametrize("step_s", [1e-3, 1e-4, 1e-5])
def test_printed_law_diverges_at_every_step(number: int, scope: str, step_s: float) -> None:
    row, trace = run(Case("cumulative", number, scope, step_s, (), substeps=2))  # type: ignore[arg-type]
    assert row.outcome == "diverges"
    assert row.diverged_s is not None
    assert row.diverged_s < 0.01
    assert row.first is not None
    assert row.first.startswith("ĝ ≈ 0")
    assert row.after_rad is None
    assert trace.t[-1] <= row.diverged_s


@BOTH
@SCOPES
def test_complete_set_runs_at_1_khz(number: int, scope: str) -> None:
    row = _rows("cumulative", number, scope)[-1]
    assert row.on == complete(row.scope)
    assert row.outcome == "runs"
    assert row.before_rad is not None
    assert row.after_rad is not None
    claimed = {1: 0.006, 2: 0.08}[number]
    assert max(*row.before_rad, *row.after_rad) < claimed


@BOTH
def test_controller_runs_at_1_khz_from_the_dead_zone_on(number: int) -> None:
    outcomes = [row.outcome for row in _rows("cumulative", number, "controller")]
    assert outcomes == ["diverges"] * 3 + ["runs"] * 3


@BOTH
@SCOPES
def test_what_is_needed_is_and_what_is_not_is_not(number: int, scope: str) -> None:
    rows = _rows("without", number, scope)
    failed = {row.label for row in rows if row.outcome != "runs"}
    expected = {"layer", "projection"} | {", ".join(pair) for pair in PAIRS}
    assert failed == (expected if scope == "controller" else expected | {"Γ_ρ"})
    assert failed == {row.label for row in rows if needed(rows, row.label)}


@BOTH
def test_five_are_not_enough_for_the_whole(number: int) -> None:
    rows = {len(row.on): row for row in _rows("cumulative", number, "whole")}
    assert rows[len(FIVE)].outcome == "diverges"
    assert rows[len(FIVE)].first == "ρ̂ of joint 2"
    last = rows[len(FIVE + FURTHER)]
    assert last.rho_error is not None
    # it runs, and estimates nothing: no better than ρ̂ = 1
    example = EXAMPLES[number]
    t = np.arange(example.fault_s + example.settle_s, 200.0, 0.01)
    nothing = np.sqrt(((example.effectiveness(t) - 1.0) ** 2).mean())
    assert last.rho_error[0] == pytest.approx(nothing, rel=0.05)


@BOTH
def test_no_value_stands_on_a_knife_s_edge(number: int) -> None:
    """Over the paper's own time; ``dftc paper --discrete`` runs 200 s."""
    for case in cases((number,)):
        if case.group == "factor" and case.scope == "controller":
            assert run(replace(case, duration_s=None))[0].outcome in ("runs", "strays"), case.label


@BOTH
def test_half_the_step_of_the_plant_changes_nothing(number: int) -> None:
    coarse, fine = (
        run(Case("other", number, "controller", 1e-3, FIVE, substeps=n))[0] for n in (4, 8)
    )
    assert coarse.after_rad == pytest.approx(fine.after_rad, rel=1e-6)
    assert coarse.before_rad == pytest.approx(fine.before_rad, rel=1e-6)


@BOTH
def test_the_split_is_what_the_default_law_and_the_observer_need(number: int) -> None:
    by_label = {
        case.label: run(case)[0]
        for case in cases((number,))
        if case.group == "other" and case.scope == "whole"
    }
    networks = by_label["(29) normalised"]
    split = by_label["(29) normalised; f̂, ĝ of the split"]
    shipped = by_label["`dftc` as it ships"]
    assert networks.rho_error is not None
    for row in (split, shipped):
        assert row.outcome == "runs"
        assert row.rho_error is not None
        assert row.rho_error[0] < 0.1 * networks.rho_error[0]
        assert row.after_rad is not None
        assert max(row.after_rad) < 1e-3


@BOTH
def test_loop_is_the_shipped_law_on_the_shipped_plant(number: int) -> None:
    """The same first 30 ms in plain Python: law.update, SciPy's integrator, torque held."""
    example, h = EXAMPLES[number], 1e-3
    case = Case("other", number, "whole", h, complete("whole"), duration_s=0.03)
    law = laws.build(
        "paper", 2, h, case.limit(), np.zeros(2), 0, case.settings(), True, np.full(2, -np.inf),
        np.full(2, np.inf), np.full(2, np.inf),
    )  # fmt: skip
    plant = CLOSED_FORMS[example.plant]
    reference = Reference(ReferenceTable(kind=example.reference, blend_s=0.0), np.zeros(2))
    x, desired, rec = np.array([*Q0, 0.0, 0.0]), np.zeros((3, 2)), np.zeros((len(NAMES), 2))
    law.start(x[:2].copy(), x[2:].copy())
    errors, torques = [], []
    for k in range(30):
        reference.target(k * h, desired)
        rec[[Q, V]], rec[[QD, VD, AD]] = x.reshape(2, 2), desired
        assert law.update(rec, np.ones(2), np.zeros(2)) == 0
        errors.append(x[:2] - desired[0])
        torques.append(rec[TAU_CMD].copy())

        def rates(_: float, z: np.ndarray) -> np.ndarray:
            acc = np.empty(2)
            plant.forward_dynamics(z[:2].copy(), z[2:].copy(), torques[-1], acc)
            return np.array([*z[2:], *acc])

        x = solve_ivp(rates, (0.0, h), x, rtol=1e-11, atol=1e-12).y[:, -1]
    _, trace = run(case)
    assert trace.t == pytest.approx([0.0, 0.01, 0.02])
    np.testing.assert_allclose(trace.error, errors[::10], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(trace.torque, torques[::10], rtol=1e-5)
    assert np.ptp(trace.torque[:, 1]) > 1.0


@pytest.mark.parametrize("plant", list(discrete_loop.PLANTS))
def test_plant_is_integrated_to_fourth_order(plant: str) -> None:
    tau, span = np.array([1.0, -0.5]), 0.2

    def end(steps: int) -> np.ndarray:
        q, v = np.array([0.5, -0.3]), np.array([0.4, 1.0])
        discrete_loop.advance(discrete_loop.PLANTS[plant], q, v, tau, span, steps, np.zeros((6, 2)))
        return np.concatenate([q, v])

    exact = end(200)
    ratio = np.abs(end(4) - exact).max() / np.abs(end(8) - exact).max()
    assert 12.0 < ratio < 24.0


@pytest.mark.parametrize("plant", list(discrete_loop.PLANTS))
def test_split_is_that_of_the_closed_form(plant: str) -> None:
    expected = ClosedFormTerms(CLOSED_FORMS[plant], "desired", np.zeros(2))
    q, v, *desired = np.random.default_rng(7).uniform(-1.0, 1.0, (5, 2))
    expected.update(q, v, *desired)
    inertia, bias = np.zeros(2), np.zeros(2)
    discrete_loop.split(
        discrete_loop.PLANTS[plant], q, v, np.array(desired), inertia, bias, np.zeros((6, 2))
    )
    np.testing.assert_allclose(inertia, expected.inertia, rtol=1e-14)
    np.testing.assert_allclose(bias, expected.bias, rtol=1e-13)


def test_values_leave_half_of_dead_beat() -> None:
    """With what reaching s leaves in δ̂ and ξ̂, the layer's slope is half of 1/h."""
    for number in (1, 2):
        for step in (1e-3, 1e-5):
            chosen = Case("cumulative", number, "controller", step, FIVE).chosen()
            scale = scales(number)
            ratio = scale.gain / np.array(chosen["g_min"])
            # reaching s from s(0) under (13), (14) alone: S cancels, and so does time
            gamma = 900.0
            left = np.sqrt(gamma / ratio) * scale.s0
            slope = ratio * left / np.array(chosen["layer"])
            assert (step * slope <= 0.5 + 1e-12).all()
            hold = scale.drift / np.array(chosen["dead_zone"])
            assert step * hold == pytest.approx([0.5, 0.5])


def test_tables_and_json() -> None:
    rows = [_row(k) for k, case in enumerate(QUICK) if case.group == "cumulative" and not case.on]
    text = table(rows)
    assert "| as printed | 4 ms: ĝ ≈ 0 of joint 2 | 2 ms: ĝ ≈ 0 of joint 1 |" in text
    for line in text.splitlines():
        if line.startswith("| as printed"):
            assert line.count("|") == 4
    loaded = json.loads(discrete.to_json(rows))
    assert [row["outcome"] for row in loaded["rows"]] == ["diverges"] * 4
    assert loaded["bounds"] == {"tracking_rad": 0.1, "chatter": 0.01}


def test_cell_says_what_came_of_a_run() -> None:
    row = Row(
        "without", 1, "controller", 1e-3, FIVE, "layer", 200.0, "chatters", None, None,
        (0.001, 0.0036), (0.0042, 0.123), (9.0, 9.0), (0.1, 234.5), None,
    )  # fmt: skip
    assert cell(row) == "chatters by 234 Nm, 3.6 / 123 mrad"
    assert needed([row], "layer")
    assert not needed([row], "leakage")


def test_study_reports_each_run_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    some = [case for case in QUICK if case.group == "cumulative" and not case.on]
    monkeypatch.setattr(discrete, "cases", lambda examples, quick: some)
    seen: list[tuple[int, int, int]] = []
    rows = discrete.study(progress=lambda k, n, row: seen.append((k, n, row.example)))
    assert seen == [(1, 4, 1), (2, 4, 1), (3, 4, 2), (4, 4, 2)]
    assert [row.scope for row in rows] == ["controller", "whole"] * 2
