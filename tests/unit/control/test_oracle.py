"""B4: the law ``dftc`` with 1/ρ of the true ρ."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.control.laws import build
from dftc_rt.control.signals import (
    OBSERVABLE,
    QD,
    RHO_HAT,
    RHO_STD,
    TAU_CMD,
    TAU_LAW,
    VERDICT,
    S,
)
from dftc_rt.errors import InputError
from tests.unit.control.baselines import make, random_record
from tests.unit.control.loop import H, load, run


def _step(t: float, out: np.ndarray) -> None:
    """Joint 2 falls to 0.5 at 20 ms, joint 3 to 0.05."""
    out.fill(1.0)
    if t >= 0.02:
        out[1], out[2] = 0.5, 0.05


def test_without_a_fault_it_is_dftc_to_the_bit() -> None:
    robot = load("ur5")
    healthy = make(robot, "oracle", effectiveness=lambda t, out: out.fill(1.0))
    plain = make(robot, "dftc")
    ours, _ = run(robot, healthy, 0.3)
    theirs, _ = run(robot, plain, 0.3)
    assert np.array_equal(ours[:, [TAU_LAW, TAU_CMD, S]], theirs[:, [TAU_LAW, TAU_CMD, S]])
    assert (ours[:, RHO_HAT] == 1.0).all()
    assert (ours[:, VERDICT] == 0.0).all()


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_command_is_that_of_dftc_over_rho_when_it_acts(delay: int) -> None:
    robot = load("ur5")
    law = make(robot, "oracle", effectiveness=_step, delay=delay, resolution=0.0)
    plain = make(robot, "dftc", ftc=False, delay=delay, resolution=0.0)
    rec, other = random_record(robot, 2), random_record(robot, 2)
    inertia, bias = np.linspace(1.0, 2.0, 6), np.linspace(-5.0, 5.0, 6)
    law.start(rec[0], rec[1])
    plain.start(rec[0], rec[1])
    for k in range(40):
        assert law.update(rec, inertia, bias) == plain.update(other, inertia, bias) == 0
        rho = np.ones(6)
        if (k + delay + 0.5) * H >= 0.02:
            rho[1], rho[2] = 0.5, 0.15  # rho_min bounds the gain
        expected = np.clip(other[TAU_LAW] / rho, -robot.limit, robot.limit)
        np.testing.assert_allclose(rec[TAU_CMD], expected, rtol=1e-12)
        true = np.ones(6)
        _step(k * H, true)
        assert np.array_equal(rec[RHO_HAT], true)
        assert np.array_equal(rec[VERDICT], (true < 0.95).astype(float))
    assert (rec[RHO_STD] == 0.0).all()
    assert (rec[OBSERVABLE] == 1.0).all()


def test_gain_off_is_dftc_with_the_gain_off() -> None:
    robot = load("ur5")
    law = make(robot, "oracle", ftc=False, effectiveness=_step)
    plain = make(robot, "dftc", ftc=False)
    ours, _ = run(robot, law, 0.1)
    theirs, _ = run(robot, plain, 0.1)
    assert np.array_equal(ours[:, TAU_CMD], theirs[:, TAU_CMD])
    assert ours[-1, RHO_HAT, 1] == 0.5


def test_skipped_ticks_move_its_clock() -> None:
    robot = load("ur5")
    law = make(robot, "oracle", effectiveness=_step)
    rec = random_record(robot, 0)
    law.start(rec[0], rec[1])
    law.update(rec, np.ones(6), np.zeros(6))
    law.skip(19)
    law.update(rec, np.ones(6), np.zeros(6))
    assert rec[RHO_HAT, 1] == 0.5
    law.start(rec[0], rec[1])
    law.update(rec, np.ones(6), np.zeros(6))
    assert rec[RHO_HAT, 1] == 1.0


def test_a_loss_costs_nothing() -> None:
    robot = load("ur5")

    def rho(t: float) -> float:
        return 1.0 if t < 1.5 else 0.6

    def true(t: float, out: np.ndarray) -> None:
        out.fill(1.0)
        out[2] = rho(t)

    law = make(robot, "oracle", effectiveness=true)
    records, truth = run(robot, law, 3.0, rho={2: rho})
    error = np.abs(truth - records[:, QD])[1400:]
    twin, truth = run(robot, make(robot, "dftc"), 3.0)
    usual = np.abs(truth - twin[:, QD])[1400:]
    assert error.max() < usual.max() + 1e-4


def test_needs_a_schedule() -> None:
    one = np.ones(1)
    with pytest.raises(InputError, match="effectiveness"):
        build("oracle", 1, 1e-3, one, one, 1, {}, False, -one, one, one)
