"""Networks fitted to rich fault-free data: the estimate they give, and what they learned."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.errors import InputError
from dftc_rt.paper import observers
from dftc_rt.paper.closed_loop import ClosedLoop, solve
from dftc_rt.paper.fit import (
    HELD_OUT_SEED,
    Form,
    Samples,
    diagnosed,
    fit,
    outputs,
    own_data,
    residual,
    rich_data,
)
from dftc_rt.paper.right_hand_side import BASE, RHO, U_CMD, X1, X1FO, X2, X2FO
from dftc_rt.paper.variant import Fitted, Variant

READINGS = tuple(r for r in observers.READINGS if r.name == "fitted")
FORMS: tuple[Form, ...] = ("desired", "split", "local")


@pytest.fixture(scope="module", params=(1, 2))
def rich(request: pytest.FixtureRequest) -> Samples:
    return rich_data(request.param)


@pytest.fixture(scope="module")
def held_out(rich: Samples) -> Samples:
    return rich_data(rich.example, HELD_OUT_SEED)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def rho_rmse(example: int, fitted: Fitted) -> float:
    """RMSE of ρ̂_1 on the paper's run, from the time on at which it is judged."""
    found = solve(Variant(example, fitted=fitted), readings=READINGS)
    assert found.failed is None
    late = found.window(found.example.fault_s + found.example.settle_s)
    return rms(found.rho_hat[late, 0, 0] - found.rho[late])


@pytest.mark.parametrize("example", [1, 2])
def test_the_estimate_follows_the_effectiveness(example: int) -> None:
    assert rho_rmse(example, fit(example)) <= 0.02


@pytest.mark.parametrize(("example", "least"), [(1, 0.04), (2, 0.3)])
def test_strictly_local_networks_cannot_know_the_other_joint(example: int, least: float) -> None:
    assert rho_rmse(example, fit(example, "local")) > least


@pytest.mark.parametrize("example", [1, 2])
def test_local_networks_and_the_interconnection_at_desired_can(example: int) -> None:
    assert rho_rmse(example, fit(example, "split")) <= 0.02


def test_a_motion_that_was_not_fitted(rich: Samples, held_out: Samples) -> None:
    error = {form: rms(residual(fit(rich.example, form, rich), held_out, 0)) for form in FORMS}
    assert error["desired"] < 0.05 * rms(held_out.acc[:, 0])
    assert error["split"] < 0.05 * rms(held_out.acc[:, 0])
    assert error["local"] > 10.0 * error["desired"]


def test_the_input_gain_is_that_of_the_plant(rich: Samples, held_out: Samples) -> None:
    """Against 1 of the printed state form, and 1/M_11(q_2) of (35), written out."""
    m11 = 1.0 if rich.example == 1 else 0.36 * np.cos(held_out.desired[:, 0, 1]) + 0.6066
    _, g_hat = outputs(fit(rich.example, "desired", rich), held_out, 0)
    assert rms(g_hat * m11 - 1.0) < 0.03


def test_rich_data_obeys_the_equations_of_motion(rich: Samples) -> None:
    """(34) in its state form and (35), joint 1, written out."""
    q, v, acc, u = rich.q, rich.v, rich.acc, rich.u
    if rich.example == 1:
        along = 1.0 - 0.1 * np.sin(q[:, 0]) + 0.1 * np.sin(q[:, 1])
        across = 0.1 * (np.cos(q[:, 0]) - np.cos(q[:, 1]))
        stretch = np.hypot(along, across) - 1.0
        force = 30.0 * (1.0 + 0.01 * stretch**2) * stretch
        spring = 0.4 * force * np.cos(q[:, 0] - np.arctan(across / along))
        wanted = acc[:, 0] - 5.88 * np.sin(q[:, 0]) + 0.036 * v[:, 0] - spring
    else:
        c2, s2 = np.cos(q[:, 1]), np.sin(q[:, 1])
        wanted = (
            (0.36 * c2 + 0.6066) * acc[:, 0] + (0.18 * c2 + 0.1233) * acc[:, 1]
            - 0.36 * s2 * v[:, 1] * v[:, 0] - 0.18 * s2 * v[:, 1] ** 2
            - 5.88 * np.sin(q[:, 0] + q[:, 1]) - 17.64 * np.sin(q[:, 0])
        )  # fmt: skip
    np.testing.assert_allclose(u[:, 0], wanted, atol=1e-9)


def test_rich_data_covers_the_references(rich: Samples) -> None:
    """What is judged lies inside what was fitted, but for the first second."""
    t = np.linspace(0.0, 40.0, 4001)
    if rich.example == 1:
        wanted = np.stack([np.ones_like(t), np.sin(t)])
    else:
        wanted = np.stack(
            [0.5 * np.cos(t) + 0.2 * np.sin(3 * t), 0.3 * np.cos(3 * t) - 0.5 * np.sin(2 * t)]
        )
    for joint in range(2):
        assert rich.q[:, joint].min() < wanted[joint].min()
        assert rich.q[:, joint].max() > wanted[joint].max()


@pytest.mark.parametrize("form", FORMS)
def test_the_compiled_observer_evaluates_the_same_networks(form: Form) -> None:
    """With x̂_fo = x and ρ̂ = 1, the rate of x̂_2fo is f̂_o + ĝ_o u."""
    fitted = fit(2, form)
    loop = ClosedLoop(Variant(2, fitted=fitted), READINGS)
    z = loop.initial().reshape(2, -1)
    z[:, X1], z[:, X2] = (0.4, -0.3), (0.5, -0.8)
    z[:, BASE + X1FO], z[:, BASE + X2FO] = z[:, X1], z[:, X2]
    z[:, BASE + RHO] = 1.0
    t = 0.7
    rates = loop.rates(t, z.ravel()).reshape(2, -1)
    u = loop.signals(t, z.ravel())[U_CMD]
    desired = np.array(
        [
            [0.5 * np.cos(t) + 0.2 * np.sin(3 * t), 0.3 * np.cos(3 * t) - 0.5 * np.sin(2 * t)],
            [-0.5 * np.sin(t) + 0.6 * np.cos(3 * t), -0.9 * np.sin(3 * t) - np.cos(2 * t)],
            [-0.5 * np.cos(t) - 1.8 * np.sin(3 * t), -2.7 * np.cos(3 * t) + 2.0 * np.sin(2 * t)],
        ]
    )
    here = Samples(
        2, z[:, X1][None].copy(), z[:, X2][None].copy(), np.zeros((1, 2)), u[None], desired[None]
    )
    for joint in range(2):
        f_hat, g_hat = outputs(fitted, here, joint)
        expected = f_hat[0] + g_hat[0] * u[joint]
        assert rates[joint, BASE + X2FO] == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(("example", "least"), [(1, 0.05), (2, 0.05)])
def test_the_papers_own_run_does_not_excite(example: int, least: float) -> None:
    """Before the fault σ(x) explains all of u there, so ĝ is anything."""
    own = own_data(solve(Variant(example), readings=READINGS))
    fitted, (poor, _) = diagnosed(example, "desired", own)
    _, (good, _) = diagnosed(example, "desired")
    assert poor.excitation < 1e-4
    assert good.excitation > 1e-3
    assert rho_rmse(example, fitted) > least


def test_an_example_that_does_not_exist() -> None:
    with pytest.raises(InputError, match="1 or 2"):
        fit(3)
