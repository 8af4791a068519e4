"""What a joint makes of its estimate: no torque at all, loads taken in, sensors that contradict."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dftc_rt.control import observer, reaction
from dftc_rt.control.signals import (
    ACTUATOR_LOSS,
    NAMES,
    OBSERVABLE,
    RHO_HAT,
    SENSOR,
    TAU_CMD,
    VERDICT,
    Q,
    V,
)
from tests.unit.control.loop import load, make, run

JOINT = 1


def _law(**gains: Any) -> Any:
    return make(
        load("panda"), attribution="hypotheses", floor_fraction=0.003, inflation=10.0, **gains
    )


@pytest.mark.parametrize(
    ("share", "lost", "expected"),
    [(0.0, 0.0, True), (0.1, 0.0, True), (0.5, 0.0, False), (1.0, 24.0, False), (0.5, 12.0, False)],
    ids=["nothing arrives", "a tenth", "half", "all, against a disturbance", "half of what grows"],
)
def test_powerless(share: float, lost: float, expected: bool) -> None:
    """φ is raised from 24 to 48 Nm in 0.1 s; y is what arrives of it, less the disturbance."""
    law = _law()
    p, x = law.storage.parameters[JOINT], law.storage.state[JOINT]
    found = False
    x["need_f"] = 24.0
    for k in range(100):
        x["phi_f"] = 24.0 * (1.0 + k / 100)
        x["y_f"] = share * x["phi_f"] - lost
        found = found or bool(reaction.powerless(p, x))
    assert found is expected


def test_a_push_that_holds_the_joint_for_a_moment_is_no_total_loss() -> None:
    """As a contact has been seen to: y near zero for 50 ms, while φ grows by 80 %."""
    law = _law()
    p, x = law.storage.parameters[JOINT], law.storage.state[JOINT]
    x["need_f"] = 24.0
    for k in range(100):
        x["phi_f"] = 24.0 * (1.0 + min(0.016 * k, 0.8))
        x["y_f"] = 0.0 if k < 50 else 0.5 * x["phi_f"]
        assert not reaction.powerless(p, x)


def test_a_motor_that_is_told_all_it_can_and_gives_nothing() -> None:
    law = _law()
    p, x = law.storage.parameters[JOINT], law.storage.state[JOINT]
    x["need_f"], x["phi_f"], x["y_f"] = 40.0, float(p["limit"]), 1.0
    found = [bool(reaction.powerless(p, x)) for _ in range(100)]
    assert 50 < found.index(True) < 70


@pytest.mark.parametrize(("phi", "need"), [(1.5, 1.5), (24.0, 0.0), (24.0, -24.0)])
def test_a_motion_that_needs_no_torque_shows_nothing(phi: float, need: float) -> None:
    """Somebody leans on a joint that stands still: φ answers, y has no reason to move."""
    law = _law()
    p, x = law.storage.parameters[JOINT], law.storage.state[JOINT]
    for k in range(100):
        x["phi_f"], x["y_f"], x["need_f"] = phi * (1.0 + k / 100), 0.0, need
        assert not reaction.powerless(p, x)


def test_a_total_loss_is_known_at_once() -> None:
    records, _ = run(load("panda"), _law(), 1.7, rho={JOINT: lambda t: 0.0 if t > 1.5 else 1.0})
    after = records[1500:, VERDICT, JOINT] == ACTUATOR_LOSS
    assert 0 < np.argmax(after) < 100
    assert records[1500 + int(np.argmax(after)), RHO_HAT, JOINT] < 0.15


def test_a_load_is_taken_in_without_a_step() -> None:
    law = _law()
    p, x = law.storage.parameters[JOINT], law.storage.state[JOINT]
    x["gain"], x["h_load"], x["load_f"], x["added"], x["active"] = 1.0, 1.5, 4.0, 6.0, 1
    x["y_f"], x["phi_f"] = 20.0, 26.0
    reaction.take(p, x)
    assert x["mass"] == 1.5
    assert x["added"] == pytest.approx(0.0)  # 6 Nm less here, 1.5 kg times 4 Nm/kg in the bias
    assert x["y_f"] == pytest.approx(26.0)
    assert x["active"] == 0
    x["h_load"] = 100.0
    reaction.take(p, x)  # never more than the compensation may add
    assert (x["mass"] - 1.5) * 4.0 <= float(p["compensation"] * p["limit"]) + 1e-9
    x["load_f"] = 1e-3
    reaction.take(p, x)
    assert x["mass"] == 3.0 * float(p["load_std_kg"])


@pytest.mark.parametrize("ftc", [True, False])
def test_a_load_that_is_taken_in_does_not_show_in_the_command(ftc: bool) -> None:
    robot = load("panda")
    law = make(robot, attribution="hypotheses", floor_fraction=0.003, inflation=10.0, ftc=ftc)
    records, _ = run(robot, law, 7.0, step_kg=(1.0, 1.5))
    mass = law.storage.state["mass"]
    if not ftc:
        assert not mass.any()
        return
    assert mass[3] == pytest.approx(1.5, abs=0.3)
    steps = np.abs(np.diff(records[1500:, TAU_CMD], axis=0)).max(axis=0)
    assert (steps < 0.03 * robot.limit).all(), steps / robot.limit
    assert not (records[:, VERDICT] == ACTUATOR_LOSS).any()


def test_a_joint_whose_position_stands_still_while_it_moves_has_a_bad_sensor() -> None:
    law = _law()
    robot = load("panda")
    inner = law.update
    frozen: list[float] = []

    def update(rec: Any, *arguments: Any) -> int:
        if law.storage.state["cycle"][0] >= 1000:
            frozen.append(float(rec[Q, JOINT])) if not frozen else None
            rec[Q, JOINT] = frozen[0]
        return int(inner(rec, *arguments))

    law.update = update
    records, _ = run(robot, law, 1.25)
    assert records.shape[1] == len(NAMES)
    moved = np.abs(np.cumsum(records[1000:, V, JOINT]) * 1e-3)
    assert moved.max() > 0.02  # it did move
    verdicts = records[1000:, VERDICT, JOINT]
    assert SENSOR in verdicts
    first = int(np.argmax(verdicts == SENSOR))
    assert (verdicts[first:] != ACTUATOR_LOSS).all()
    assert (records[1000 + first, OBSERVABLE, JOINT]) == 0.0
    assert not (records[:1000, VERDICT] == SENSOR).any()


def test_recursive_least_squares_weighs_samples_by_their_age() -> None:
    """Against the closed form: the sum of exp(-age/T) (y - ρ φ)²/R and the faded prior."""
    rng = np.random.default_rng(1)
    h, memory, r = 1e-3, 0.05, 0.3
    phi = rng.normal(4.0, 2.0, 400)
    y = np.where(np.arange(400) < 200, 1.0, 0.6) * phi + rng.normal(0.0, 0.5, 400)
    rho, var = 1.0, 0.09
    for a, b in zip(phi, y, strict=True):
        var = observer.fade(var, memory, h, 1e9)
        rho, var = observer.kalman(rho, var, a, b, r, 0.0, 0.0, 1.0, h)
    weight = np.exp(-np.arange(399, -1, -1) * h / memory)
    prior = np.exp(-400 * h / memory) / 0.09
    information = prior + np.sum(weight * phi**2) / r
    assert rho == pytest.approx((prior + np.sum(weight * phi * y) / r) / information, rel=1e-9)
    assert var == pytest.approx(1.0 / information, rel=1e-9)
    assert observer.fade(0.5, 1e-3, 1.0, 0.09) == 0.09


@pytest.mark.parametrize("estimator", ["kalman", "rls", "gradient"])
def test_every_estimator_finds_a_loss_in_the_loop(estimator: str) -> None:
    law = _law(observer=estimator)
    records, _ = run(load("panda"), law, 3.0, rho={JOINT: lambda t: 0.6 if t > 1.0 else 1.0})
    assert (records[2500:, VERDICT, JOINT] == ACTUATOR_LOSS).all()
    error = records[2500:, RHO_HAT, JOINT] - 0.6
    assert np.sqrt(np.mean(error**2)) < 0.05
