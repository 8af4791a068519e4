"""The rules behind the verdicts, on numbers and runs made up by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dftc_rt.paper.claims import Judge
from dftc_rt.paper.examples import EXAMPLES
from dftc_rt.paper.measures import Measures, measure
from dftc_rt.paper.right_hand_side import E1O, E2O
from dftc_rt.paper.runs import Drawn, fault_free, slug
from dftc_rt.paper.variant import Variant
from dftc_rt.paper.verdicts import CONDITIONAL, DOES_NOT, REPRODUCES, Finding, Sampled
from tests.paper import synthetic

NO_GAIN = slug(Variant(2))
REMOVED = slug(Variant(2, robust="removed"))
HEALTHY = slug(fault_free(2, 0.01))


def judged(
    changed: dict[str, Measures], sampled: Sampled | None = None, drawn: Drawn | None = None
) -> dict[int, Finding]:
    """Findings of Example 2, by number 6-10."""
    found = synthetic.measures(2, drawn) | changed
    judge = Judge(EXAMPLES[2], found, drawn or Drawn(), sampled)
    return {finding.figure: finding for finding in judge.findings()}


def with_rho(**rmse: float) -> Measures:
    known = synthetic.measures(2)[NO_GAIN].rho_rmse
    return replace(synthetic.QUIET, rho_rmse=known | rmse)


def lost(rad: float) -> Measures:
    known = synthetic.measures(2)[NO_GAIN]
    return replace(known, faulty_rms=(rad, 1e-3), faulty_largest=(2 * rad, 2e-3))


def test_where_all_is_well_only_the_lost_joint_is_missing() -> None:
    verdicts = {n: f.verdict for n, f in judged({}).items()}
    assert verdicts == {
        6: REPRODUCES, 7: DOES_NOT, 8: REPRODUCES, 9: REPRODUCES, 10: REPRODUCES,
    }  # fmt: skip
    assert "hide the fault" in judged({})[7].remark


@pytest.mark.parametrize("example", [1, 2])
def test_figures_are_numbered_by_example(example: int) -> None:
    judge = Judge(EXAMPLES[example], synthetic.measures(example), Drawn())
    first = 5 * (example - 1) + 1
    assert [f.figure for f in judge.findings()] == list(range(first, first + 5))


def test_tracking_is_judged_by_the_worst_joint_after_the_start() -> None:
    off = replace(synthetic.measures(2)[HEALTHY], healthy_largest=(1e-3, 0.0101))
    finding = judged({HEALTHY: off})[6]
    assert finding.verdict == CONDITIONAL  # ε = 0.1 and 0.001 still track
    assert finding.conditions == ("ε = 0.1", "ε = 0.001")
    assert finding.rows[0].number == pytest.approx(10.1)


def test_a_lost_joint_reproduces_the_figure_without_the_gain() -> None:
    finding = judged({NO_GAIN: lost(0.5)})[7]
    assert finding.verdict == REPRODUCES
    assert finding.remark == ""


def test_a_joint_that_is_lost_without_the_fault_too_reproduces_nothing() -> None:
    twin = slug(Variant(2, fault=False, robust="removed"))
    assert judged({REMOVED: lost(0.5)})[7].verdict == CONDITIONAL
    assert judged({REMOVED: lost(0.5)})[7].conditions == ("δ̂, ξ̂ removed",)
    finding = judged({REMOVED: lost(0.5), twin: lost(0.3)})[7]
    assert finding.verdict == DOES_NOT
    assert "without the fault as well" in finding.remark


def test_a_large_ratio_of_small_errors_is_no_lost_joint() -> None:
    tiny = replace(synthetic.measures(2)[HEALTHY], faulty_rms=(1e-6, 1e-6))
    assert judged({NO_GAIN: lost(0.009), HEALTHY: tiny})[7].verdict == DOES_NOT


def test_identification_needs_both_errors_to_vanish() -> None:
    known = synthetic.measures(2)[HEALTHY]
    for off in ({"identification_velocity": 0.011}, {"identification_position": 0.011}):
        assert judged({HEALTHY: replace(known, **off)})[8].verdict == CONDITIONAL


def test_an_estimate_that_needs_the_true_rho_says_so() -> None:
    blind = with_rho(measured=0.2)
    names = [slug(Variant(2, gain="measured"))]
    names += [slug(Variant(2, gain="true_rho", identifier=i)) for i in ("frozen", "adapt")]
    names += [slug(Variant(2, gain="true_rho", robust=r)) for r in ("held", "removed")]
    names += [slug(Variant(2, e, gain="true_rho")) for e in (0.1, 0.001)]
    finding = judged(dict.fromkeys(names, blind))[9]
    assert finding.verdict == CONDITIONAL
    assert finding.conditions == ("the true ρ in (27), which a robot does not have",)


def test_ours_counts_for_no_verdict() -> None:
    bad = with_rho(measured=0.2, true_rho=0.2)
    finding = judged({name: bad for name in synthetic.measures(2) if "gain" in name})[9]
    assert any(row.met for row in finding.rows)
    assert finding.verdict == DOES_NOT


def test_the_gain_gets_no_credit_where_the_law_tracks_without_it() -> None:
    assert "So does the law without the gain" in judged({})[10].remark
    assert judged({NO_GAIN: lost(0.5)})[10].remark == ""
    gain = slug(Variant(2, gain="measured"))
    assert judged({gain: lost(0.5)})[10].verdict == CONDITIONAL


def test_what_could_not_be_measured_is_not_met() -> None:
    nothing = Measures(*[(math.nan, math.nan)] * 4, math.nan, math.nan, {}, "gave up")
    finding = judged({HEALTHY: nothing})[6]
    assert finding.rows[0].number is None
    assert not finding.rows[0].met


def test_targets_are_held_against_their_limits() -> None:
    found = synthetic.measures(2)
    loop = slug(Variant(2, gain="desired"))
    limits = [0.005, 0.02, 0.02]
    for noisy, expected in ((0.019, True), (0.021, False)):
        judge = Judge(EXAMPLES[2], found, Drawn(), Sampled(noisy, (1, 1), (2, 2), "done"))
        assert [t.limit for t in judge.targets()] == limits
        assert judge.targets()[2].met is expected
    stopped = Judge(EXAMPLES[2], found, Drawn(), Sampled(0.001, (1, 1), (2, 2), "safe stop"))
    assert stopped.targets()[2].number is None
    assert not stopped.targets()[2].met
    worse = found | {loop: with_rho(desired=0.0051, fitted=0.0201)}
    assert [t.met for t in Judge(EXAMPLES[2], worse, Drawn()).targets()] == [False] * 3


def test_what_is_drawn_by_a_flag_gets_a_row() -> None:
    drawn = Drawn((2,), gain="frozen", robust="held", identifier="adapt")
    found = judged({}, drawn=drawn)
    for figure in (7, 9, 10):
        assert any("as drawn" in row.title for row in found[figure].rows)
        assert not any("as drawn" in row.title for row in judged({})[figure].rows)


# --- what the numbers are


def test_measures_of_a_run() -> None:
    run = synthetic.solution(Variant(2, gain="desired"))
    run.q[(run.t > 0.5) & (run.t < 0.9), 0] += 1.0  # the start is not judged
    run.q[(run.t > 2.0) & (run.t < 3.0), 1] += 0.1
    run.q[run.t >= 4.0, 0] += 0.02
    run.q[(run.t >= 4.0) & (run.t < 4.45), 1] += 1.0  # nor the transient of the fault
    run.rho_hat[run.t > 4.6, 0, 0] += 0.1
    run.rho_hat[run.t < 4.4, 1, 0] = 0.0
    run.signals[run.t < 0.9, E2O, 0] = 5.0
    run.signals[run.t > 9.0, E2O, 1] = -0.3
    run.signals[run.t > 9.0, E1O, 1] = 0.2
    found = measure(run)
    assert found.healthy_largest == pytest.approx((0.0, 0.1))
    assert found.healthy_rms[1] == pytest.approx(0.1 * np.sqrt(1.0 / 3.0), rel=0.02)
    assert found.faulty_largest == pytest.approx((0.02, 0.0))
    assert found.rho_rmse["desired"] == pytest.approx(0.1 * np.sqrt(5.4 / 5.5), rel=0.01)
    assert found.rho_rmse["frozen"] == 0.0
    assert set(found.rho_rmse) == {"desired", "frozen", "fitted"}
    assert found.identification_velocity == pytest.approx(0.3)
    assert found.identification_position == pytest.approx(0.2)


def test_a_healthy_run_is_healthy_to_its_end() -> None:
    run = synthetic.solution(fault_free(2, 0.01))
    run.q[run.t > 9.0, 0] += 0.1
    found = measure(run)
    assert found.healthy_largest[0] == pytest.approx(0.1)
    assert found.faulty_largest[0] == pytest.approx(0.1)  # to compare with the faulty run


def test_a_run_that_broke_off_has_no_faulty_time() -> None:
    found = measure(synthetic.solution(Variant(2), failed="step too small"))
    assert math.isnan(found.faulty_rms[0])
    assert found.failed == "step too small"
