"""The columns are what the kernel's residual is linear in."""

import numpy as np

from dftc_rt.control import laws, signals
from dftc_rt.control.dftc import Dftc
from dftc_rt.identification.regressors import Basis, Samples, columns

N, CYCLES, PERIOD = 2, 600, 1e-3
GRID = {"basis": "grid", "grid_q": 4, "grid_v": 5, "basis_width": 0.8}


def _law(**weights: object) -> Dftc:
    law = laws.build(
        "dftc", N, PERIOD, 50.0, 0.0, np.array([1, 2]), {**GRID, **weights}, False,
        np.array([-1.0, -2.0]), np.array([1.5, 2.0]), np.array([2.0, 3.0]),
    )  # fmt: skip
    assert isinstance(law, Dftc)
    return law


def _motion() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    t = np.arange(CYCLES)[:, None] * PERIOD
    phase = rng.uniform(0, 6, N)
    q, v = 0.8 * np.sin(7 * t + phase), 5.6 * np.cos(7 * t + phase)
    inertia = 1.5 + np.sin(3 * t + phase)
    bias = 6.0 * np.cos(2 * t + phase)
    told = 10.0 * np.sin(11 * t + phase) + rng.normal(0, 0.3, (CYCLES, N))
    return q, v, inertia, bias, told


def _run(law: Dftc) -> tuple[np.ndarray, np.ndarray]:
    """y_f and φ_f of the kernel, (K, n) each, while other commands were sent than its own."""
    q, v, inertia, bias, told = _motion()
    rec = np.zeros((len(signals.NAMES), N))
    y_f, phi_f = np.empty((2, CYCLES, N))
    law.start(q[0], v[0])
    depth = law.storage.history.shape[1]
    for k in range(CYCLES):
        rec[signals.Q], rec[signals.V], rec[signals.QD], rec[signals.VD] = q[k], v[k], q[k], v[k]
        law.update(rec, inertia[k], bias[k])
        law.storage.history[:, k % depth] = told[k]
        y_f[k], phi_f[k] = law.storage.state["y_f"], law.storage.state["phi_f"]
    return y_f, phi_f


def test_the_kernels_residual_is_the_regression() -> None:
    rng = np.random.default_rng(5)
    w_fo, w_go = rng.normal(0, 3.0, (N, 20)), rng.normal(0, 0.03, (N, 20))
    blank, filled = _law(), _law(w_fo=w_fo, w_go=w_go)
    y_f, phi_f = _run(blank)
    y_n, phi_n = _run(filled)
    q, v, inertia, _, _ = _motion()
    store, start, every = blank.storage, 300, 7  # the kernel's first sample spans two cycles
    for i in range(N):
        par = store.parameters[i]
        grid = Basis(store.centres[i], par["inv_width1"], par["inv_width2"])
        samples = Samples(q[:, i], v[:, i], inertia[:, i], y_f[:, i], phi_f[:, i], par["alpha"])
        table, residual = columns(samples, grid, start, every)
        left = (y_n - phi_n)[start::every, i]
        change = table @ np.concatenate([w_fo[i], w_go[i]])
        assert np.abs(change).max() > 0.5
        np.testing.assert_allclose(residual - change, left, atol=1e-9)
