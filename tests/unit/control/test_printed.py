"""The ``paper`` law over several cycles against an independent NumPy transcription."""

from typing import Any

import numpy as np
import pytest

from dftc_rt.control.dftc import Dftc
from dftc_rt.control.laws import build
from dftc_rt.control.signals import AD, NAMES, QD, RHO_HAT, TAU_CMD, TAU_LAW, VD, Q, V

H = 1e-3
CENTRES = np.arange(-3.0, 4.0)[:, None] * np.ones(2)
W_FO = [-0.2, 0.3, -0.6, 0.5, -0.3, 0.4, -0.4]
W_GO = [-0.4, 0.1, -0.1, -0.9, -0.3, 0.7, 0.5]
M, B = 2.0, 3.0


def _law(name: str = "paper", **gains: Any) -> Dftc:
    law = build(
        name, 1, H, 1e3, 0.0, 0, {"torque_lag_s": 0.0, **gains}, True,
        np.array([-3.0]), np.array([3.0]), np.array([2.0]),
    )  # fmt: skip
    assert isinstance(law, Dftc)
    return law


def _motion(k: int) -> tuple[float, float, float, float, float]:
    t = 0.05 * k
    return 0.4 + 0.3 * np.sin(t), 0.5 + 0.2 * np.cos(t), np.sin(t), np.cos(t), -np.sin(t)


@pytest.mark.parametrize("corrected", ["on", "off"])
@pytest.mark.parametrize("identifier", ["adapt", "frozen"])
def test_identifier_and_observer_are_18_to_29(identifier: str, corrected: str) -> None:
    law = _law(
        w_fo=W_FO, w_go=W_GO, identifier=identifier, observer_correction=corrected,
        gamma_go=5.0, gamma_delta_o=5.0, gamma_rho=20.0, x1o_offset=-2.0, x2o_offset=1.0,
    )  # fmt: skip
    q, v, *_ = _motion(0)
    law.start(np.array([q]), np.array([v]))
    wf, wg, delta, rho, u = np.array(W_FO), np.array(W_GO), 0.0, 1.0, 0.0
    x1o, x2o = q - 2.0, v + 1.0
    x1f, x2f = x1o, x2o
    for k in range(40):
        q, v, qd, vd, ad = _motion(k)
        rec = np.zeros((len(NAMES), 1))
        rec[[Q, V, QD, VD, AD], 0] = q, v, qd, vd, ad
        assert law.update(rec, np.ones(1), np.zeros(1)) == 0
        if k > 0:
            sigma = np.exp(-((np.array([q, v]) - CENTRES) ** 2).sum(1) / (2 * 0.5**2))
            f, g = wf @ sigma, wg @ sigma
            e1, e2, e1f, e2f = q - x1o, v - x2o, q - x1f, v - x2f
            big_e = 1 + abs(e2) + e2**2
            corr = delta * np.sign(e2) * big_e + 100.0 * e2
            used = corr if corrected == "on" else 0.0
            used1 = 40.0 * e1 if corrected == "on" else 0.0
            x1f += H * (x2f + used1 + 30.0 * e1f)
            x2f += H * (f + g * rho * u + used + 30.0 * e2f)
            rho += H * 20.0 * e2f * g * u
            x1o += H * (x2o + 40.0 * e1)
            x2o += H * (f + g * u + corr)
            if identifier == "adapt":
                wf = wf + H * 0.002 * e2 * sigma
                wg = wg + H * 5.0 * e2 * sigma * u
                delta += H * 5.0 * abs(e2) * big_e
        u = rec[TAU_CMD, 0]
        assert u == pytest.approx(rec[TAU_LAW, 0] / max(rho, 0.01), rel=1e-10)
        assert rec[RHO_HAT, 0] == pytest.approx(rho, rel=1e-10)
    state = law.storage.state[0]
    expected = {"x1o": x1o, "x2o": x2o, "x1fo": x1f, "x2fo": x2f, "delta_o": delta}
    for name, value in expected.items():
        assert state[name] == pytest.approx(value, rel=1e-9), name
    np.testing.assert_allclose(law.storage.weights[0, 2], wf, rtol=1e-10)
    np.testing.assert_allclose(law.storage.weights[0, 3], wg, rtol=1e-10)
    assert abs(rho - 1.0) > 1e-4


def test_networks_correct_the_split_in_the_law_and_in_the_residual() -> None:
    gains = {
        "basis": "diagonal", "basis_width": 0.5, "lam": 5.0, "k": 10.0, "gamma_delta": 0.0,
        "gamma_xi": 0.0, "rho_loss": 0.0,
    }  # fmt: skip
    law = _law("dftc", w_f=0.3, w_g=0.01, w_fo=0.2, w_go=-0.01, **gains)
    plain = _law("dftc", **gains)
    q, v, qd, vd, ad = _motion(3)
    sigma = np.exp(-((np.array([q, v]) - CENTRES) ** 2).sum(1) / (2 * 0.5**2)).sum()
    for each in (law, plain):
        each.start(np.array([q]), np.array([v]))
    for _ in range(400):
        rec, ref = np.zeros((len(NAMES), 1)), np.zeros((len(NAMES), 1))
        for row in (rec, ref):
            row[[Q, V, QD, VD, AD], 0] = q, v, qd, vd, ad
        # one joint held still by the same torque: y = M 0 + bias
        law.update(rec, np.array([M]), np.array([B]))
        plain.update(ref, np.array([M]), np.array([B]))
    s = 5.0 * (q - qd) + v - vd
    state = law.storage.state[0]
    drive = 10.0 * s - ad + 5.0 * (v - vd)
    u = -(drive - B / M + 0.3 * sigma) * M / (1 + 0.01 * sigma)
    assert rec[TAU_LAW, 0] == pytest.approx(u, rel=1e-12)
    assert state["y_f"] == pytest.approx(B - M * 0.2 * sigma, rel=1e-9)
    assert plain.storage.state[0]["y_f"] == pytest.approx(B, rel=1e-9)
    ratio = state["phi_f"] / rec[TAU_CMD, 0]
    assert ratio == pytest.approx(1 - 0.01 * sigma, rel=1e-9)
