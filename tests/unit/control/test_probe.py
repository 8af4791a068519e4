"""The test torque: its correlations, the response that it meets, and what a test proves."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from dftc_rt.control import probe
from dftc_rt.control.dftc import Dftc
from dftc_rt.control.laws import build
from dftc_rt.control.layout import allocate
from dftc_rt.control.settings import parse
from dftc_rt.control.signals import ACTUATOR_LOSS, TAU_CMD, VERDICT
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
            for column in range(probe.SHAPE):
                assert abs(slow @ row[:, column]) < 1e-9 * size


def test_neighbours_that_test_together_do_not_hear_each_other() -> None:
    """Nor from another phase; a test that overlaps in part is heard a little."""
    table, _ = probe.table(6, H, np.full(6, 0.3))
    assert probe.sizes(table) == pytest.approx(75.0, rel=0.01)
    burst = 0.0
    for i in range(6):
        own = probe.sizes(table)[i]
        for j in set(range(6)) - {i}:
            phase = probe.frequency(j, 0.3) * np.arange(N) * H + 1.0
            assert np.hypot(*(table[i, :, c] @ np.sin(phase) for c in (0, 1))) < 0.01 * own
            for offset in range(-N + 1, N, 7):
                other = np.zeros(N)
                k = np.arange(max(0, offset), min(N, N + offset))
                other[k] = table[j, k - offset, probe.SHAPE]
                heard = np.hypot(*(table[i, :, c] @ other for c in (0, 1))) / own
                burst = max(burst, float(heard))
    assert 0.05 < burst < 0.25


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
        (0.8, 0.0, 1.0, -1e-9, 1e-9),  # torque is missing in the test, not in the residual
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


@pytest.mark.parametrize("reference", [7, 8, 9])
def test_a_regression_calls_a_disturbed_joint_weak(reference: int) -> None:
    """Why there is a test: joint 4 loses torque, and healthy joint 2 seems to have lost more."""
    law = _law()
    seen: list[tuple[float, float]] = []
    inner = law.update

    def update(rec: Any, *arguments: Any) -> int:
        status = inner(rec, *arguments)
        state = law.storage.state
        seen.append((float(state["phi_f"][1]), float(state["y_f"][1])))
        return status

    law.update = update  # type: ignore[method-assign]
    loss = {3: lambda t: 0.6 if t > 1.0 else 1.0}
    records, _ = run(load("panda"), law, 2.5, rho=loss, reference=reference)
    phi, y = np.array(seen[1000:1100]).T
    slope = np.cov(phi, y)[0, 1] / np.var(phi, ddof=1)
    assert slope < 0.7
    assert (records[-1, VERDICT] == ACTUATOR_LOSS).tolist() == [i == 3 for i in range(7)]
    assert not (records[:, VERDICT, 1] == ACTUATOR_LOSS).any()


def test_a_test_torque_is_in_the_command_only_when_it_is_on() -> None:
    loss = {1: lambda t: 0.6 if t > 1.0 else 1.0}
    waves = {}
    for amplitude in (0.0, 0.02):
        law = _law(probe=amplitude, attribution_margin=1e6)
        records, _ = run(load("panda"), law, 2.0, rho=loss)
        t = np.arange(1200, 1500) * H
        omega = probe.frequency(1, 0.3)
        command = np.diff(records[1200:1500, TAU_CMD, 1], prepend=records[1199, TAU_CMD, 1])
        waves[amplitude] = abs(np.sum(np.hanning(300) * command * np.exp(-1j * omega * t)))
        assert (law.storage.state["probe_tries"][1] > 0) == (amplitude > 0.0)
    assert waves[0.02] > 5.0 * waves[0.0]


def _finished(ratio: complex, share: float = 1.0, beside: float = 0.0) -> Any:
    """State of a joint after one test whose wave reached the command in part."""
    law = _law()
    law.start(np.zeros(7), np.zeros(7))
    state = law.storage.state
    probe.answer(state, law.storage.sums, 0, 1.0 + 0j)
    p, x = law.storage.parameters[0], state[0]
    sent = share * float(p["probe_size"])
    x["h_loss"] = 0.4
    sums = law.storage.sums[0]
    sums[0, probe.COSINE] = sent
    sums[1, probe.COSINE], sums[1, probe.SINE] = (sent * ratio).real, -(sent * ratio).imag
    sums[1, 2] = sums[1, 4] = beside * sent
    probe.finish(p, x, sums)
    return state


@pytest.mark.parametrize(
    ("ratio", "share"),
    [(-0.3 - 0.5j, 1.0), (0.06 - 0.38j, 1.0), (1.8 + 0j, 1.0), (0.6 + 0j, 0.3)],
    ids=["pushed", "pushed less", "more than all", "the command was clipped"],
)
def test_a_spoilt_test_does_not_count(ratio: complex, share: float) -> None:
    state = _finished(ratio, share)
    assert state["probe_count"][0] == 0
    assert state["probe_evidence"][0] == 0.0
    assert state["probe_tries"][0] == 1
    good = _finished(0.6 + 0.02j)
    assert good["probe_count"][0] == 1
    assert good["probe_evidence"][0] > 4.0


def test_what_is_beside_the_line_makes_a_test_prove_less() -> None:
    clean, disturbed = _finished(0.6 + 0j), _finished(0.6 + 0j, beside=0.2)
    assert disturbed["probe_std"][0] == pytest.approx(0.2 / np.sqrt(2.0))
    assert disturbed["probe_evidence"][0] < 1.0 < clean["probe_evidence"][0]


@pytest.mark.parametrize("at", [80, 150, 230])
def test_an_edge_within_a_test_is_seen_beside_the_line(at: int) -> None:
    """A contact ends: y jumps. The error that it makes is no surprise."""
    law = _law()
    law.start(np.zeros(7), np.zeros(7))
    state, sums = law.storage.state, law.storage.sums
    p, x = law.storage.parameters[0], state[0]
    for edge in (0.0, 4.0 * float(p["probe"] * p["limit"])):
        probe.answer(state, sums, 0, 1.0 + 0j)
        for k in range(N):
            wave = probe.torque(p, x, law.storage.correlations[0])
            y = 0.6 * wave + (edge if k > at else 0.0)
            probe.sample(p, x, sums[0], law.storage.correlations[0], wave, y, 0.5, 1)
        error = abs(complex(x["probe_re"], x["probe_im"]) - 0.6)
        if edge:
            assert 0.02 < error < 3.0 * float(x["probe_std"])
        else:
            assert error < 1e-9
            assert x["probe_std"] < 1e-9


def test_what_the_joint_itself_sends_beside_the_line_is_no_disturbance() -> None:
    law = _law()
    sums = law.storage.sums[0]
    sums[1, 2] = sums[1, 5] = 0.3
    assert probe.chance(sums, 0j) == pytest.approx(0.3 / np.sqrt(2.0))
    sums[0, 2] = sums[0, 5] = 0.3
    assert probe.chance(sums, 1.0 + 0j) == pytest.approx(0.0)


def test_what_spoke_against_a_loss_is_forgotten_when_it_gets_worse() -> None:
    law = _law()
    x = law.storage.state[0]
    x["probe_level"], x["probe_wait"] = 0.85, 10.0
    for level, evidence, kept in ((0.75, -15.0, -15.0), (0.5, 6.0, 6.0), (0.5, -15.0, 0.0)):
        x["h_loss"], x["probe_evidence"] = 1.0 - level, evidence
        probe.revise(x)
        assert x["probe_evidence"] == kept
    assert x["probe_wait"] < 0.1


def test_a_motor_without_a_limit_is_not_tested() -> None:
    robot = load("panda")
    free = np.full(robot.n, np.inf)
    none = np.zeros(robot.n)
    law = build("dftc", robot.n, H, robot.limit, none, 1, {}, True, -free, free, free)
    assert isinstance(law, Dftc)
    store = allocate(
        parse({}, robot.n, printed=False),
        dataclasses.replace(law.joints, torque_limit=free),
        ftc=True,
    )
    assert not store.parameters["probe"].any()
    assert not store.parameters["probe_size"].any()


def test_tests_get_rarer() -> None:
    law = _law()
    law.start(np.zeros(7), np.zeros(7))
    state = law.storage.state
    waits = []
    for _ in range(8):
        probe.stop(state[0])
        waits.append(float(state["probe_wait"][0]))
    assert waits[0] < 0.1
    assert waits[-1] >= 1.0
    state["probe_evidence"][0] = 15.0
    probe.stop(state[0])
    assert state["probe_wait"][0] >= 10.0


def test_a_missing_sample_ends_a_test() -> None:
    law = _law()
    law.start(np.zeros(7), np.zeros(7))
    state = law.storage.state
    probe.answer(state, law.storage.sums, 0, 1.0 + 0j)
    p, x = law.storage.parameters[0], state[0]
    sums = law.storage.sums[0]
    probe.sample(p, x, sums, law.storage.correlations[0], 1.0, 1.0, 0.5, 1)
    assert state["probe_at"][0] == 1
    probe.sample(p, x, sums, law.storage.correlations[0], 1.0, 1.0, 0.5, 2)
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
