"""Plants for which ideal weights exist, in closed loop with the product's right-hand sides.

f_i = W*_fᵀσ(x_i), g_i = W*_gᵀσ(x_i) with W*_g > 0, ω_i bounded by ξ_i, and an interconnection
within its bound by construction: h_i = Σ_j d_ij S_j cos(ν_ij t + φ_ij), or the same with E_j, or
with a constant in the place of S_j. Everything that the paper's controller computes comes from
:mod:`dftc_rt.control.rates` and the blocks beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from dftc_rt.control import basis, identifier, law, layout, observer, rates, settings
from dftc_rt.paper import lyapunov

M = 7
X1, X2, DELTA, XI, X1O, X2O, DELTA_O, X1F, X2F, X1FO, X2FO, RHO = range(12)
LOSS, LOSS_O, LOSS_F, SLACK, SLACK_O = range(12, 17)
"""Integrals: what the theorems say is lost at least, and what tanh may add at most."""
W_F, W_G, W_FO, W_GO = (slice(17 + M * k, 17 + M * (k + 1)) for k in range(4))
STATES = 17 + 4 * M
S, U, H, G_HAT, F_O, G_O = range(6)
"""Rows of what is computed on the way."""
BOUND_S, BOUND_E, BOUND_1 = range(3)
"""What bounds the interconnection: S_j, E_j, or 1."""
CENTRES = basis.diagonal_centres(1)[0]
SMOOTHING = lyapunov.SMOOTHING


@dataclass
class Plant:
    """One plant of n joints with its reference, start and settings.

    ``par`` are the parameters that V is written with; ``run`` those that the loop runs with,
    where a test flips a sign.
    """

    par: Any
    run: Any
    z0: np.ndarray
    w_f: np.ndarray
    w_g: np.ndarray
    d: np.ndarray
    xi: np.ndarray
    nu: np.ndarray
    phase: np.ndarray
    rho: np.ndarray
    bounded_by: int = BOUND_S
    measured: bool = False
    """(28), (29) read the plant's state in the place of (27)."""

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.xi)

    @property
    def delta(self) -> float:
        """δ of the proof: n times the largest d over all pairs."""
        return float(self.n * self.d.max())

    def rates(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rates (n, STATES) and signals (6, n)."""
        z = np.ascontiguousarray(z).reshape(self.n, STATES)
        dz, sig = np.zeros_like(z), np.zeros((6, self.n))
        _rates(
            t, z, dz, sig, self.run, self.w_f, self.w_g, self.d, self.xi, self.nu, self.phase,
            self.rho, self.bounded_by, self.measured, np.zeros(M),
        )  # fmt: skip
        return dz, sig

    def tracking(self, z: np.ndarray, s: np.ndarray, delta: Any = None) -> np.ndarray:
        """V_i of (15) at states (…, n, STATES)."""
        return lyapunov.tracking(
            self.par, s, self.w_f - z[..., W_F], self.w_g * self.rho[:, None] - z[..., W_G],
            (self.delta if delta is None else delta) - z[..., DELTA], self.xi - z[..., XI],
        )  # fmt: skip

    def identification(self, z: np.ndarray, delta_o: Any) -> np.ndarray:
        """V_io of (24) at states (…, n, STATES)."""
        return lyapunov.identification(
            self.par, z[..., X1] - z[..., X1O], z[..., X2] - z[..., X2O],
            self.w_f - z[..., W_FO], self.w_g - z[..., W_GO], delta_o - z[..., DELTA_O],
        )  # fmt: skip

    def estimation(self, z: np.ndarray) -> np.ndarray:
        """V_if of (30) at states (…, n, STATES)."""
        x1, x2 = (X1, X2) if self.measured else (X1F, X2F)
        return lyapunov.estimation(
            self.par, z[..., x1] - z[..., X1FO], z[..., x2] - z[..., X2FO], self.rho - z[..., RHO]
        )


@dataclass
class Motion:
    """Samples of a run: times (K,), states (K, n, STATES), signals (K, 6, n)."""

    t: np.ndarray
    z: np.ndarray
    sig: np.ndarray
    end: str


@njit
def _reference(t: float, i: int) -> tuple[float, float, float]:
    """q_d, q̇_d, q̈_d of joint i: a slow sine, rad."""
    w, p = 0.7 + 0.2 * i, 1.1 * i
    arg = w * t + p
    return 0.5 * np.sin(arg), 0.5 * w * np.cos(arg), -0.5 * w * w * np.sin(arg)


@njit
def _rates(
    t: float, z: Any, dz: Any, sig: Any, par: Any, w_f: Any, w_g: Any, d: Any, xi: Any, nu: Any,
    phase: Any, rho: Any, bounded_by: int, measured: bool, sigma: Any,
) -> None:  # fmt: skip
    n = z.shape[0]
    size = np.ones(n)
    for i in range(n):
        q_d, v_d, _ = _reference(t, i)
        sig[S, i] = law.sliding(par[i].lam, z[i, X1] - q_d, z[i, X2] - v_d)
        if bounded_by == BOUND_S:
            size[i] = law.interconnection_bound(sig[S, i], np.inf)
        elif bounded_by == BOUND_E:
            size[i] = law.interconnection_bound(z[i, X2] - z[i, X2O], np.inf)
    for i in range(n):
        p, x, dx = par[i], z[i], dz[i]
        _, v_d, a_d = _reference(t, i)
        s, q, v = sig[S, i], x[X1], x[X2]
        basis.gaussian(q, v, CENTRES, p.inv_width1, p.inv_width2, sigma)
        h = 0.0
        for j in range(n):
            h += d[i, j] * size[j] * np.cos(nu[i, j] * t + phase[i, j])
        h += xi[i] * np.cos(nu[i, i] * t + 1.0)  # ω_i
        # law (10), (11)-(14)
        wf, wg = basis.network(x[W_F], sigma), basis.network(x[W_G], sigma)
        f_hat, g_hat = rates.models(p, 1.0, 0.0, wf, wg)
        u = rates.torque(p, s, v - v_d, a_d, f_hat, g_hat, x[DELTA], x[XI])
        drive_delta, drive_xi = rates.bound_drives(p, s)
        dx[DELTA] = law.bound_rate(x[DELTA], drive_delta, p.leak_delta)
        dx[XI] = law.bound_rate(x[XI], drive_xi, p.leak_xi)
        drive_f, drive_g = rates.weight_drives(p, s, u)
        # identifier (18), (21)-(23)
        e1o, e2o = q - x[X1O], v - x[X2O]
        f_o, g_o = basis.network(x[W_FO], sigma), basis.network(x[W_GO], sigma)
        corr = rates.identifier_correction(p, e2o, x[DELTA_O])
        dx[X1O] = identifier.rate1(x[X2O], p.l1, e1o)
        dx[X2O] = identifier.rate2(f_o, g_o, u, corr)
        dx[DELTA_O] = law.bound_rate(x[DELTA_O], rates.identifier_bound_drive(p, e2o), p.leak_o)
        drive_fo, drive_go = rates.identifier_weight_drives(p, e2o, u)
        wfs, wgs, wfos, wgos = dx[W_F], dx[W_G], dx[W_FO], dx[W_GO]
        for k in range(M):
            wfs[k] = basis.weight_rate(x[W_F][k], sigma[k], drive_f, p.leak_f)
            wgs[k] = basis.weight_rate(x[W_G][k], sigma[k], drive_g, p.leak_g)
            wfos[k] = basis.weight_rate(x[W_FO][k], sigma[k], drive_fo, p.leak_o)
            wgos[k] = basis.weight_rate(x[W_GO][k], sigma[k], drive_go, p.leak_o)
        # (27), and the observer (28), (29)
        dx[X1F] = identifier.rate1(x[X2F], p.l1, e1o)
        dx[X2F] = observer.faulty_rate(rho[i], f_o, g_o, u, corr)
        x1, x2 = (q, v) if measured else (x[X1F], x[X2F])
        dx[X1FO], dx[X2FO], dx[RHO] = rates.observer_rates(
            p, x[RHO], x[X1FO], x[X2FO], x1, x2, f_o, g_o, u, p.l1 * e1o, corr
        )
        # plant (2)
        dx[X1] = v
        dx[X2] = basis.network(w_f[i], sigma) + basis.network(w_g[i], sigma) * rho[i] * u + h
        # integrals of the bounds, see dftc_rt/paper/lyapunov.py
        e1f, e2f = x1 - x[X1FO], x2 - x[X2FO]
        dx[LOSS] = p.k * s * s
        dx[LOSS_O] = (p.l1 - 0.5) * e1o * e1o + (p.l2 - 0.5) * e2o * e2o
        dx[LOSS_F] = (p.l1f - 0.5) * e1f * e1f + (p.l2f - 0.5) * e2f * e2f
        big_s = law.interconnection_bound(s, np.inf)
        big_e = law.interconnection_bound(e2o, np.inf)
        dx[SLACK] = SMOOTHING * p.layer * (x[DELTA] * big_s + x[XI])
        dx[SLACK_O] = SMOOTHING * p.layer_o * x[DELTA_O] * big_e
        sig[U, i], sig[H, i], sig[G_HAT, i] = u, h, g_hat
        sig[F_O, i], sig[G_O, i] = f_o, g_o


def parameters(n: int, epsilon: float, **gains: Any) -> Any:
    """Parameters of the law ``paper`` with tanh(s/ε) for sgn, (n,)."""
    smooth = {"layer": epsilon, "layer_o": epsilon, "layer_shape": "tanh", "basis_width": 2.0}
    parsed = settings.parse({**smooth, **gains}, n, printed=True)
    endless = np.full(n, np.inf)
    joints = layout.Joints(
        1.0, endless, np.zeros(n), np.zeros(n, dtype=np.int64), -endless, endless, endless
    )
    return layout.allocate(parsed, joints, ftc=False).parameters


def draw(seed: int, n: int, epsilon: float, gains: dict[str, Any], **changes: Any) -> Plant:
    """A plant from a seed; ``changes`` replace attributes."""
    rng = np.random.default_rng(seed)
    par = parameters(n, epsilon, **gains)
    w_f, w_g = rng.uniform(-4.0, 4.0, (n, M)), rng.uniform(0.6, 1.4, (n, M))
    z = np.zeros((n, STATES))
    z[:, X1], z[:, X2] = rng.uniform(-1.0, 1.0, (2, n))
    z[:, X1O], z[:, X2O] = z[:, X1] + rng.uniform(-1, 1, n), z[:, X2] + rng.uniform(-1, 1, n)
    z[:, X1F], z[:, X2F] = z[:, X1FO], z[:, X2FO] = z[:, X1], z[:, X2]
    z[:, X1FO] += rng.uniform(-0.2, 0.2, n)
    z[:, X2FO] += rng.uniform(-0.2, 0.2, n)
    z[:, W_F], z[:, W_FO] = rng.uniform(-4.0, 4.0, (2, n, M))
    z[:, W_G], z[:, W_GO] = w_g * rng.uniform(0.4, 1.6, (2, n, 1))
    z[:, RHO] = 1.0
    plant = Plant(
        par, par.copy(), z, w_f, w_g, rng.uniform(0.03, 0.12, (n, n)), rng.uniform(0.1, 0.3, n),
        rng.uniform(0.5, 6.0, (n, n)), rng.uniform(0.0, 2 * np.pi, (n, n)), np.ones(n),
    )  # fmt: skip
    for name, value in changes.items():
        setattr(plant, name, value)
    return plant


def solve(plant: Plant, duration: float, samples: int = 1000, rtol: float = 1e-9) -> Motion:
    """Integrate with LSODA; ends early where (10) would divide by nothing or the joint runs away.

    Only a loop with a flipped sign may end early: ``end`` says "" or why.
    """

    def joints(z: np.ndarray, row: int) -> np.ndarray:
        return z.reshape(plant.n, STATES)[:, row]

    def rhs(t: float, z: np.ndarray) -> np.ndarray:
        return plant.rates(t, z)[0].ravel()

    def away(t: float, z: np.ndarray) -> float:
        _, sig = plant.rates(t, z)
        e2o, rho = np.abs(joints(z, X2) - joints(z, X2O)), np.abs(joints(z, RHO))
        tops = (30.0 - np.abs(sig[S]).max(), 10.0 - e2o.max(), 100.0 - rho.max())
        return min(*tops, sig[G_HAT].min() - 0.05)

    away.terminal = True  # type: ignore[attr-defined]
    times = np.linspace(0.0, duration, samples + 1)
    result = solve_ivp(
        rhs, (0.0, duration), plant.z0.ravel(), method="LSODA", t_eval=times, rtol=rtol,
        atol=1e-11, events=away, max_step=0.05,
    )  # fmt: skip
    z = result.y.T.reshape(-1, plant.n, STATES)
    sig = np.array([plant.rates(t, s)[1] for t, s in zip(result.t, z, strict=True)])
    end = "" if result.status == 0 else (result.message if result.status < 0 else "ran away")
    return Motion(result.t, z, sig, end)
