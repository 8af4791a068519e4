"""Competing explanations: what wins on made-up residuals, and what must not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dftc_rt.control import attribution
from dftc_rt.control.signals import ACTUATOR_LOSS, ANOMALY, DISTURBANCE, PAYLOAD_CHANGE, UNKNOWN
from tests.unit.control.loop import load, make

H = 1e-3
LIMIT = 87.0
F64 = np.ndarray[Any, np.dtype[np.float64]]


class Joint:
    """One joint's explanations, fed with whole series."""

    def __init__(self, **gains: Any) -> None:
        law: Any = make(load("panda"), attribution="hypotheses", **gains)
        store = law.storage
        self.tested = 1.5  # nats that test torques added
        self.p, self.x, self.moments = store.parameters[0:1], store.state[0:1], store.moments[0]

    def see(self, e: F64, phi: F64, load: F64, friction: F64, variance: float) -> float:
        """Feed everything; returns the verdict at the end."""
        p, x = self.p[0], self.x[0]
        attribution.begin(x, self.moments, float(phi[0]))
        verdict = ANOMALY
        for row in zip(e, phi, load, friction, strict=True):
            attribution.explain(p, x, self.moments, *map(float, row), variance, H)
            verdict = attribution.verdict(p, x, self.tested, verdict)
        return verdict


def series(seconds: float = 3.0) -> tuple[F64, F64, F64, F64]:
    """Time, and φ, w, tanh that move independently of each other."""
    t = np.arange(0.0, seconds, H)
    phi = 20.0 + 12.0 * np.sin(3.0 * t)
    load = 3.0 + 1.5 * np.cos(2.0 * t + 0.3)
    friction = np.tanh(np.cos(2.5 * t) / attribution.V_FRICTION)
    return t, phi, load, friction


def noise(n: int, std: float) -> F64:
    return np.random.default_rng(4).normal(0.0, std, n)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("loss", ACTUATOR_LOSS),
        ("payload", PAYLOAD_CHANGE),
        ("drift", DISTURBANCE),
        ("friction", DISTURBANCE),
    ],
)
def test_the_true_explanation_wins(kind: str, expected: float) -> None:
    t, phi, load, friction = series()
    e = {
        "loss": -0.4 * phi,
        "payload": -1.5 * load,
        "drift": 5.0 - 2.0 * t,
        "friction": -1.0 * friction,
    }[kind]
    joint = Joint()
    assert joint.see(e + noise(len(t), 0.2), phi, load, friction, 0.04) == expected
    if kind == "loss":
        assert joint.x["h_loss"][0] == pytest.approx(0.4, abs=0.01)
    if kind == "payload":
        assert joint.x["h_load"][0] == pytest.approx(1.5, abs=0.05)


def test_nothing_wins_while_nothing_moves() -> None:
    t = series()[0]
    still = np.ones_like(t)
    e = -0.4 * 20.0 * still + noise(len(t), 0.2)
    assert Joint().see(e, 20.0 * still, 3.0 * still, 0.0 * still, 0.04) == ANOMALY


def test_without_a_test_a_loss_is_not_named_unless_tests_are_off() -> None:
    t, phi, load, friction = series()
    e = -0.4 * phi + noise(len(t), 0.2)
    for tested, gains, expected in (
        (0.0, {}, ANOMALY),
        (0.0, {"probe": 0.0}, ACTUATOR_LOSS),
        (-3.0, {}, ANOMALY),
    ):
        joint = Joint(**gains)
        joint.tested = tested
        found = joint.see(e, phi, load, friction, 0.04)
        assert (found == ACTUATOR_LOSS) == (expected == ACTUATOR_LOSS)


def test_a_small_loss_or_an_unloaded_joint_is_never_a_loss() -> None:
    t, phi, load, friction = series()
    small = Joint().see(-0.06 * phi + noise(len(t), 0.05), phi, load, friction, 0.0025)
    assert small != ACTUATOR_LOSS
    light = 0.1 * phi  # 2.6 % of the limit
    e = -0.4 * light + noise(len(t), 0.02)
    assert Joint().see(e, light, 0.1 * load, friction, 0.0004) != ACTUATOR_LOSS


def test_what_nothing_explains_is_unknown() -> None:
    t, phi, load, friction = series()
    e = 8.0 * np.sign(np.sin(2 * np.pi * 7.0 * t))
    assert Joint().see(e, phi, load, friction, 0.04) == UNKNOWN


def test_a_loss_is_kept_until_something_else_is_better() -> None:
    """A ρ that moves on is still a loss, though no constant ρ fits it."""
    t, phi, load, friction = series(4.0)
    rho = np.where(t < 2.0, 0.6, 0.6 - 0.1 * (t - 2.0))
    joint = Joint()
    assert joint.see(-(1.0 - rho) * phi, phi, load, friction, 0.04) == ACTUATOR_LOSS
    gone = Joint()
    e = np.where(t < 1.5, -0.4 * phi, -2.0 * load)
    assert gone.see(e + noise(len(t), 0.1), phi, load, friction, 0.01) != ACTUATOR_LOSS


def test_the_fits_are_ridge_least_squares() -> None:
    rng = np.random.default_rng(2)
    z = rng.normal(size=(50, attribution.MOMENTS))
    moments = z.T @ z
    theta, left = attribution.one(moments, 1, 0.7)
    assert theta == pytest.approx((z[:, 1] @ z[:, 0]) / (z[:, 1] @ z[:, 1] + 0.7))
    best = np.sum((z[:, 0] - theta * z[:, 1]) ** 2) + 0.7 * theta**2
    assert left == pytest.approx(best)
    a = np.vstack([z[:, [3, 4]], np.diag(np.sqrt([0.2, 0.3]))])
    b = np.concatenate([z[:, 0], [0.0, 0.0]])
    residual = b - a @ np.linalg.lstsq(a, b, rcond=None)[0]
    assert attribution.two(moments, 3, 4, 0.2, 0.3) == pytest.approx(residual @ residual)


def test_two_signals_that_are_one_are_fitted_as_one() -> None:
    z = np.random.default_rng(3).normal(size=(40, attribution.MOMENTS))
    z[:, 4] = z[:, 3]
    moments = z.T @ z
    alone = attribution.one(moments, 3, 0.0)[1]
    assert attribution.two(moments, 3, 4, 0.0, 0.0) == pytest.approx(alone)
