"""The decision stage against the likelihoods it is made of."""

import numpy as np
import pytest
from scipy.stats import norm

from dftc_rt.control import decision
from dftc_rt.control.signals import ACTUATOR_LOSS, ANOMALY, HEALTHY, NOT_OBSERVABLE


def test_ratio_is_that_of_two_gaussians() -> None:
    phi, y, rho, var = 5.0, 3.2, 0.8, 0.6
    expected = norm.logpdf(y, rho * phi, var**0.5) - norm.logpdf(y, phi, var**0.5)
    assert decision.log_likelihood_ratio(phi, y, rho, var) == pytest.approx(expected)


@pytest.mark.parametrize("phi", [-5.0, 5.0])
def test_ratio_grows_under_a_loss_and_falls_without(phi: float) -> None:
    assert decision.log_likelihood_ratio(phi, 0.8 * phi, 0.8, 1.0) > 0.0
    assert decision.log_likelihood_ratio(phi, phi, 0.8, 1.0) < 0.0


def test_cusum_is_pages_sum_with_a_top() -> None:
    steps = np.array([-1.0, 2.0, 3.0, -1.0, 9.0, -20.0, 1.0])
    total, seen = 0.0, []
    for step in steps:
        total = decision.cusum(total, step, 10.0)
        seen.append(total)
    assert seen == [0.0, 2.0, 5.0, 4.0, 10.0, 0.0, 1.0]


def _verdict(before: float = HEALTHY, **changes: float) -> float:
    given = {
        "loss": 0.0, "excess": 0.0, "rho_hat": 1.0, "clear_for": 0.0, "observable": True,
        "threshold_anomaly": 6.0, "threshold_loss": 15.0, "rho_loss": 0.9, "clear_s": 0.5,
    }  # fmt: skip
    return decision.verdict(before, *(given | changes).values())


def test_verdicts() -> None:
    assert _verdict() == HEALTHY
    assert _verdict(observable=False) == NOT_OBSERVABLE
    assert _verdict(loss=7.0) == ANOMALY
    assert _verdict(excess=16.0) == ANOMALY
    assert _verdict(loss=16.0, rho_hat=0.6) == ACTUATOR_LOSS
    assert _verdict(loss=16.0, rho_hat=0.95) == ANOMALY


def test_a_loss_is_kept_until_rho_has_been_near_one_for_long_enough() -> None:
    assert _verdict(ACTUATOR_LOSS, rho_hat=0.99, clear_for=0.4) == ACTUATOR_LOSS
    assert _verdict(ACTUATOR_LOSS, observable=False) == ACTUATOR_LOSS
    assert _verdict(ACTUATOR_LOSS, rho_hat=0.99, clear_for=0.5) == HEALTHY
    assert decision.clearing(0.4, 0.96, 0.95, 0.1) == pytest.approx(0.5)
    assert decision.clearing(0.4, 0.94, 0.95, 0.1) == 0.0
