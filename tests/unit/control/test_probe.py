"""The test torque: its correlations, the response that it meets, and what a test proves."""

from __future__ import annotations

import numpy as np
import pytest

from dftc_rt.control import probe
from dftc_rt.control.dftc import Dftc
from dftc_rt.control.signals import VERDICT
from tests.unit.control.loop import load, make, run

H = 1e-3
N = 300


def test_slow_signals_drop_out() -> None:
    table, lengths = probe.table(7, H, np.full(7, 0.3))
    assert lengths.tolist() == [N] * 7
    t = np.arange(N)
    for row in table:
        size = np.abs(row[:, probe.SHAPE] @ row[:, probe.SINE])
        for power in range(3):
            slow = (t / N) ** power
            assert abs(slow @ row[:, probe.COSINE]) < 1e-9 * size
            assert abs(slow @ row[:, probe.SINE]) < 1e-9 * size


def test_neighbours_do_not_hear_each_other() -> None:
    """Nor from another phase, the tests having started at different times."""
    table, _ = probe.table(6, H, np.full(6, 0.3))
    for i in range(6):
        own = np.hypot(*(table[i, :, c] @ table[i, :, probe.SHAPE] for c in (0, 1)))
        for j in range(6):
            phase = probe.frequency(j, 0.3) * np.arange(N) * H + 1.0
            heard = np.hypot(*(table[i, :, c] @ np.sin(phase) for c in (0, 1)))
            if i != j:
                assert heard < 0.01 * own


def test_a_joint_alone_answers_as_the_model_says() -> None:
    g = probe.response(np.diag([2.0, 3.0]), np.array([2.0, 3.0]), 0, 100.0, *np.full((3, 2), 25.0))
    assert g == pytest.approx(1.0)


def test_response_is_that_of_the_coupled_equations() -> None:
    """Against a simulation of M q̈ = τ in which the other joint has its feedback."""
    mass = np.array([[2.0, 1.2], [1.2, 1.5]])
    lam, k = np.array([20.0, 20.0]), np.array([30.0, 30.0])
    omega = probe.frequency(0, 0.3)
    q, v = np.zeros(2), np.zeros(2)
    step = 1e-5
    y = u = 0j
    for n in range(200_000):
        t = n * step
        drive = np.sin(omega * t)
        tau = np.array([drive, -mass[1, 1] * ((lam[1] + k[1]) * v[1] + lam[1] * k[1] * q[1])])
        a = np.linalg.solve(mass, tau)
        v += step * a
        q += step * v
        if t > 1.4:
            turn = np.exp(-1j * omega * t)
            y += mass[0, 0] * a[0] * turn
            u += drive * turn
    g = probe.response(mass, np.diag(mass), 0, omega, lam, k, np.zeros(2))
    assert y / u == pytest.approx(g, rel=0.02)


@pytest.mark.parametrize(
    ("ratio", "quadrature", "level", "least", "most"),
    [
        (0.6, 0.0, 0.6, 4.0, 5.0),  # agrees with the loss
        (1.0, 0.0, 0.6, -5.0, -4.0),  # the motor gives all that it is told
        (0.1, 0.0, 0.6, -1e-9, 1e-9),  # agrees with nothing: spoilt
        (0.6, 0.5, 0.6, 0.0, 0.5),  # out of phase: spoilt
        (0.8, 0.0, 0.8, 4.0, 5.0),
    ],
)
def test_evidence(ratio: float, quadrature: float, level: float, least: float, most: float) -> None:
    assert least <= probe.evidence(ratio, quadrature, level, 0.98, 0.045) <= most


def test_a_load_is_expected_to_answer_less() -> None:
    alone = probe.evidence(0.8, 0.0, 0.75, 0.98, 0.045)
    loaded = probe.evidence(0.8, 0.0, 0.75, 0.8, 0.045)
    assert loaded < 0.0 < alone


def _law(**gains: object) -> Dftc:
    robot = load("panda")
    law = make(robot, attribution="hypotheses", floor_fraction=0.003, inflation=10.0, **gains)
    assert isinstance(law, Dftc)
    return law


def test_a_weak_joint_asks_and_the_answer_is_rho() -> None:
    law = _law(attribution_margin=1e6)  # so that it goes on asking
    heard = []
    state = law.storage.state
    inner = law._cycle

    def cycle(*arguments: object) -> int:
        before = int(state["probe_count"][1])
        status = inner(*arguments)
        if state["probe_count"][1] > max(before, 0):
            heard.append(complex(state["probe_re"][1], state["probe_im"][1]))
        return status

    law._cycle = cycle
    run(load("panda"), law, 3.0, rho={1: lambda t: 0.6 if t > 1.0 else 1.0})
    assert len(heard) >= 3
    np.testing.assert_allclose(heard[1:], 0.6, atol=0.06)


def test_without_a_test_torque_the_command_is_the_law_alone() -> None:
    records, _ = run(
        load("panda"), _law(probe=0.0), 2.0, rho={1: lambda t: 0.6 if t > 1.0 else 1.0}
    )
    law = _law()
    asked, _ = run(load("panda"), law, 2.0, rho={1: lambda t: 0.6 if t > 1.0 else 1.0})
    healthy = asked[:1000] - records[:1000]
    assert np.nanmax(np.abs(healthy)) == 0.0
    assert np.isin(asked[:, VERDICT, 1], [7.0, 1.0]).any()
    assert int(law.storage.state["probe_count"][1]) > 0


def test_a_missing_sample_ends_a_test() -> None:
    law = _law()
    law.start(np.zeros(7), np.zeros(7))
    state = law.storage.state
    probe.answer(state, 0, 1.0 + 0j)
    p, x = law.storage.parameters[0], state[0]
    probe.sample(p, x, law.storage.correlations[0], 1.0, 1.0, 0.5, 1)
    assert state["probe_at"][0] == 1
    probe.sample(p, x, law.storage.correlations[0], 1.0, 1.0, 0.5, 2)
    assert state["probe_at"][0] == probe.IDLE
    assert state["probe_count"][0] == 0


def test_a_joint_at_rest_is_not_asked() -> None:
    """Friction would hold it against the torque, which would look like a loss."""
    law = _law()
    law.start(np.zeros(7), np.zeros(7))
    state = law.storage.state
    state["since"][0], state["effort"][0], state["h_loss"][0] = 1.0, 1e4, 0.5
    p, x = law.storage.parameters[0], state[0]
    assert not probe.ask(p, x, 50.0, 1.0, 0.0)
    assert probe.ask(p, x, 50.0, 1.0, 0.3)
    assert state["probe_at"][0] == probe.ASKED
