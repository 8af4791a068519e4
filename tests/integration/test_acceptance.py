"""What the product promises: a 40 % loss on a loaded joint costs next to nothing.

Exact model, no friction, surrogate ``desired``, 20 s with the fault at 6 s, judged against
the same scenario and seed without the fault.
"""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import pytest

from tests.integration.acceptance import CASES, SCENARIOS, Verdict, judge

RATIO = 1.25
FLOOR_MRAD = 0.5
RHO_RMSE = 0.03


@pytest.fixture(scope="module")
def verdicts() -> dict[str, Verdict]:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        return {j: verdict for found in pool.map(judge, SCENARIOS) for j, verdict in found.items()}


@pytest.fixture(params=[joint for _, joint in CASES])
def joint(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


def test_faulted_joint_tracks_as_its_twin(verdicts: dict[str, Verdict], joint: str) -> None:
    found = verdicts[joint].metrics[joint]
    twin = found["rmse_twin_mrad"]
    assert found["rmse_faulty_mrad"] <= max(RATIO * twin, twin + FLOOR_MRAD)


def test_other_joints_track_as_their_twins(verdicts: dict[str, Verdict], joint: str) -> None:
    others = {name: m for name, m in verdicts[joint].metrics.items() if name != joint}
    ratios = {n: m["rmse_faulty_mrad"] / m["rmse_twin_mrad"] for n, m in others.items()}
    assert len(ratios) >= 5
    assert max(ratios.values()) <= RATIO, ratios


def test_effectiveness_is_estimated_and_the_loss_is_called(
    verdicts: dict[str, Verdict], joint: str
) -> None:
    found = verdicts[joint].metrics
    assert found[joint]["rho_rmse"] <= RHO_RMSE
    assert found[joint]["detection_delay_s"] < 0.5
    assert sum(m["false_alarms"] for m in found.values()) == 0


def test_without_tolerance_the_fault_shows(verdicts: dict[str, Verdict], joint: str) -> None:
    verdict = verdicts[joint]
    with_ftc, without, computed_torque = verdict.early
    assert computed_torque >= 3.0 * with_ftc
    assert 0.0 < without < 1e3  # mrad: ran to the end, finite
    assert verdict.end_states == ("done",) * 4
