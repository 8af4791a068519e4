"""What the defaults must do on Panda and UR5: noisy 1 kHz data, delay, lag, quantisation.

Windows are those of the contract: from 0.5 s after the fault; the twin is the same run without
the fault.
"""

from functools import cache

import numpy as np
import pytest

from dftc_rt.control.signals import ACTUATOR_LOSS, QD, RHO_HAT, VERDICT
from tests.unit.control.loop import Rho, load, make, run

START = 6.0
DURATION = 12.0


def _rmse(records: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Tracking error of each joint after the fault, mrad."""
    window = slice(round((START + 0.5) * 1000), None)
    error = truth[window] - records[window, QD]
    return np.asarray(1e3 * np.sqrt((error**2).mean(0)))


@cache
def _twin(robot: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    return run(load(robot), make(load(robot)), DURATION, seed=seed, reference=7 + seed)


def _faulty(robot: str, law: str, joint: int, rho: Rho, seed: int) -> tuple[np.ndarray, np.ndarray]:
    return run(
        load(robot), make(load(robot), law), DURATION, rho={joint: rho}, seed=seed,
        reference=7 + seed,
    )  # fmt: skip


def _loss(t: float) -> float:
    return 1.0 if t < START else 0.6


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(("robot", "joint"), [("panda", 1), ("panda", 3), ("ur5", 1), ("ur5", 2)])
def test_constant_loss_costs_almost_nothing(robot: str, joint: int, seed: int) -> None:
    twin = _rmse(*_twin(robot, seed))
    records, truth = _faulty(robot, "dftc", joint, _loss, seed)
    rmse = _rmse(records, truth)
    floor = _rmse(*_faulty(robot, "computed_torque", joint, _loss, seed))
    estimate = records[round((START + 0.5) * 1000) :, RHO_HAT, joint]
    alarms = np.argwhere(records[:, VERDICT] == ACTUATOR_LOSS)
    assert rmse[joint] <= max(1.25 * twin[joint], twin[joint] + 0.5)
    assert (np.delete(rmse, joint) <= 1.25 * np.delete(twin, joint)).all()
    assert np.sqrt(((estimate - 0.6) ** 2).mean()) <= 0.03
    assert set(alarms[:, 1]) == {joint}
    assert START < 1e-3 * alarms[0, 0] < START + 0.5
    assert floor[joint] >= 3.0 * rmse[joint]


@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_no_alarm_without_a_fault(robot: str) -> None:
    for seed in (0, 1):
        records, _ = _twin(robot, seed)
        assert not (records[:, VERDICT] == ACTUATOR_LOSS).any()


@pytest.mark.parametrize(("robot", "joint"), [("panda", 3), ("ur5", 2)])
def test_sinusoidal_loss_is_followed(robot: str, joint: int) -> None:
    def rho(t: float) -> float:
        return 1.0 if t < START else float(0.8 + 0.2 * np.cos(3.0 * (t - START)))

    records, truth = _faulty(robot, "dftc", joint, rho, 0)
    first = round((START + 0.5) * 1000)
    true = np.array([rho(1e-3 * k) for k in range(first, len(records))])
    assert np.sqrt(((records[first:, RHO_HAT, joint] - true) ** 2).mean()) < 0.04
    assert _rmse(records, truth)[joint] < 1.5


def test_total_loss_is_estimated_as_one() -> None:
    records, _ = _faulty("ur5", "dftc", 2, lambda t: 1.0 if t < START else 0.0, 0)
    after = records[round((START + 0.3) * 1000) : round((START + 0.5) * 1000)]
    assert (after[:, VERDICT, 2] == ACTUATOR_LOSS).all()
    assert after[:, RHO_HAT, 2].max() < 0.15
    assert np.isfinite(records[:, 5:7]).all()
