"""The right-hand side of the closed loop, compiled for one plant.

Put together from :mod:`dftc_rt.control.rates` and the blocks it uses, the same functions that
the discrete law steps. The state is (2, states): the rows of :data:`BASE` for a joint, then
:data:`PER_OBSERVER` for each of its observers.

Source: [zhao2017] eq. (1)-(33).
"""

from __future__ import annotations

import functools
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

from dftc_rt.control import basis, gain, identifier, law, observer, rates
from dftc_rt.dynamics.closed_form.plants import CLOSED_FORMS, Compiled
from dftc_rt.reference import sines

FLOOR: Final = 1.0
"""ĝ u, rad/s², below which a normalised observer slows down."""

_STEP: Final = 1.5e-8  # of a forward difference, relative; root of the machine precision

M: Final = 7
"""Basis functions of a network."""
X1, X2, DELTA, XI, X1O, X2O, DELTA_O = range(7)
W_F, W_G, W_FO, W_GO = (slice(7 + M * k, 7 + M * (k + 1)) for k in range(4))
BASE: Final = 7 + 4 * M
"""States of a joint before those of its observers."""
X1F, X2F, X1FO, X2FO, RHO = range(5)
PER_OBSERVER: Final = 5

S, U, U_CMD, RHO_TRUE, F_O, G_O, E1O, E2O, QD, VD, AD = range(11)
SIGNALS: Final = 11
"""Rows of what is computed on the way: s, u, u^DFTC, ρ, f̂_o, ĝ_o, e_1o, e_2o, desired motion."""

ON: Final = 0
HELD: Final = 1
REMOVED: Final = 2
"""What becomes of δ̂, ξ̂ and the controller's networks under the fault."""

NO_GAIN: Final = -1
TRUE_GAIN: Final = -2
"""Sources of the gain that are no observer."""

_CENTRES = basis.diagonal_centres(1)[0]


class Mode(NamedTuple):
    """What acts in a stretch of the run, and how single equations are read.

    Attributes:
        delta: :data:`ON`, :data:`HELD` or :data:`REMOVED`, of δ̂.
        xi: The same of ξ̂.
        learns: The controller's networks adapt.
        trains: The identifier adapts.
        source: Index of the observer that drives the gain, :data:`NO_GAIN` or
            :data:`TRUE_GAIN`.
        known: f̂, ĝ of the controller are those of the split at `desired`.
        error13: |e| in the place of |s| in (13).
        applied12: u as applied in (12), not the law before the gain.
        sgn18: sgn(e_2o) is in (18).
        delivered18: The identifier and its copies are told ρ u, not u.
        limit: Torque at which the actuators saturate, Nm.
    """

    delta: int
    xi: int
    learns: bool
    trains: bool
    source: int
    known: bool
    error13: bool
    applied12: bool
    sgn18: bool
    delivered18: bool
    limit: float


def _build(local_terms: Compiled, forward_dynamics: Compiled) -> tuple[Compiled, Compiled]:
    """Compile the right-hand side and its Jacobian for one plant."""

    @njit
    def joint_observers(
        p: Any, z: Any, dz: Any, forms: Any, f_o: Any, g_o: Any, rho: float, u: float,
        corr1: float, corr2: float,
    ) -> None:  # fmt: skip
        """Rates of all observers of one joint; f_o, g_o hold the models by source."""
        for r in range(forms.shape[0]):
            form = forms[r]
            at = BASE + PER_OBSERVER * r
            f, g = f_o[form.models], g_o[form.models]
            on = form.correction == 1
            c1, c2 = (corr1, corr2) if on else (0.0, 0.0)
            x1, x2 = z[X1], z[X2]
            dz[at + X1F] = dz[at + X2F] = 0.0
            if form.true_rho == 1:
                x1, x2 = z[at + X1F], z[at + X2F]
                dz[at + X1F] = identifier.rate1(x2, 1.0, c1)
                dz[at + X2F] = observer.faulty_rate(rho, f, g, u, c2)
            e1f, e2f = x1 - z[at + X1FO], x2 - z[at + X2FO]
            dz[at + X1FO], dz[at + X2FO] = observer.copy_rates(
                z[at + RHO], z[at + X2FO], e1f, e2f, f, g, u, c1, c2, p.l1f, form.l2f
            )
            if form.normalised == 1:
                dz[at + RHO] = observer.normalised_rate(e2f, g * u, form.gamma_rho, FLOOR)
            else:
                dz[at + RHO] = observer.rho_rate(e2f, g, u, form.gamma_rho)

    @njit
    def rhs(
        t: float, z: Any, dz: Any, sig: Any, par: Any, motion: Any, fault: Any, mode: Any,
        forms: Any, fit: Any, work: Any,
    ) -> None:  # fmt: skip
        """Rates ``dz`` and signals ``sig`` (SIGNALS, 2) at time t and state z (2, states)."""
        offset, amplitude, omega, phase = motion
        source = mode.source
        fit_centres, fit_width, fit_f, fit_g, fit_h = fit
        vectors, matrix, sigma, fit_sigma = work
        q, v, desired = vectors[0], vectors[1], vectors[2:5]
        zero, tau, acc = vectors[5], vectors[6], vectors[7]
        inertia, bias = vectors[8:11], vectors[11:14]
        for i in range(2):
            q[i], v[i] = z[i, X1], z[i, X2]
        sines(t, offset, amplitude, omega, phase, desired)
        local_terms(q, v, desired[0], desired[1], desired[2], matrix, inertia[0], bias[0])
        local_terms(q, v, zero, zero, zero, matrix, inertia[1], bias[1])
        local_terms(q, v, q, v, desired[2], matrix, inertia[2], bias[2])
        f_o, g_o, fit_x = np.empty(5), np.empty(5), np.empty(5)
        for i in range(2):
            p, x, dx = par[i], z[i], dz[i]
            rho = fault[i, 0] + fault[i, 1] * np.cos(fault[i, 2] * t)
            s = law.sliding(p.lam, q[i] - desired[0, i], v[i] - desired[1, i])
            basis.gaussian(q[i], v[i], _CENTRES, p.inv_width1, p.inv_width2, sigma)
            wf, wg = basis.network(x[W_F], sigma), basis.network(x[W_G], sigma)
            f_hat, g_hat = rates.models(p, 1.0, 0.0, wf, wg)
            if mode.known:
                f_hat, g_hat = law.drift(inertia[0, i], bias[0, i], 0.0), 1.0 / inertia[0, i]
            delta = 0.0 if mode.delta == REMOVED else x[DELTA]
            xi = 0.0 if mode.xi == REMOVED else x[XI]
            e2 = v[i] - desired[1, i]
            u = rates.torque(p, s, e2, desired[2, i], f_hat, g_hat, delta, xi)
            wanted = 1.0
            if source >= 0:
                rho_hat = x[BASE + PER_OBSERVER * source + RHO]
                wanted = gain.target(rho_hat, p.rho_min, p.rho_max)
            elif source == TRUE_GAIN:
                wanted = gain.target(rho, p.rho_min, p.rho_max)
            told = min(max(wanted * u, -mode.limit), mode.limit)
            tau[i] = rho * told
            # adaptation (11)-(14)
            drive_delta, drive_xi = rates.bound_drives(p, s)
            if mode.error13:
                size = law.magnitude(q[i] - desired[0, i], p.dead_zone)
                big_s = law.interconnection_bound(s, p.s_bound)
                drive_delta = law.interconnection_drive(p.gamma_delta, size, big_s)
            drive_f, drive_g = rates.weight_drives(p, s, told if mode.applied12 else u)
            learns = 1.0 if mode.learns else 0.0
            moves_delta = 1.0 if mode.delta == ON else 0.0
            moves_xi = 1.0 if mode.xi == ON else 0.0
            dx[DELTA] = moves_delta * law.bound_rate(x[DELTA], drive_delta, p.leak_delta)
            dx[XI] = moves_xi * law.bound_rate(x[XI], drive_xi, p.leak_xi)
            # identifier (18), (21)-(23)
            e1o, e2o = q[i] - x[X1O], v[i] - x[X2O]
            f_o[0], g_o[0] = basis.network(x[W_FO], sigma), basis.network(x[W_GO], sigma)
            corr = rates.identifier_correction(p, e2o, x[DELTA_O])
            if not mode.sgn18:
                big_e = law.interconnection_bound(e2o, p.s_bound)
                corr = identifier.correction(x[DELTA_O], big_e, 1.0, p.l2, e2o)
            seen = tau[i] if mode.delivered18 else told
            dx[X1O] = identifier.rate1(x[X2O], p.l1, e1o)
            dx[X2O] = identifier.rate2(f_o[0], g_o[0], seen, corr)
            drive_fo, drive_go = rates.identifier_weight_drives(p, e2o, seen)
            trains = 1.0 if mode.trains else 0.0
            dx[DELTA_O] = trains * law.bound_rate(
                x[DELTA_O], rates.identifier_bound_drive(p, e2o), p.leak_o
            )
            wfs, wgs, wfos, wgos = dx[W_F], dx[W_G], dx[W_FO], dx[W_GO]
            for k in range(M):
                sk = sigma[k]
                wfs[k] = learns * basis.weight_rate(x[W_F][k], sk, drive_f, p.leak_f)
                wgs[k] = learns * basis.weight_rate(x[W_G][k], sk, drive_g, p.leak_g)
                wfos[k] = trains * basis.weight_rate(x[W_FO][k], sk, drive_fo, p.leak_o)
                wgos[k] = trains * basis.weight_rate(x[W_GO][k], sk, drive_go, p.leak_o)
            # observers (27)-(29)
            for k in range(3):
                g_o[1 + k] = 1.0 / inertia[k, i]
                f_o[1 + k] = law.drift(inertia[k, i], bias[k, i], 0.0)
            # 2 inputs: x_i; 5: the other joint's desired state as well
            fit_x[0], fit_x[1], fit_x[2] = q[i], v[i], desired[0, 1 - i]
            fit_x[3], fit_x[4] = desired[1, 1 - i], desired[2, 1 - i]
            for k in range(fit_sigma.shape[0]):
                distance = 0.0
                for c in range(fit_centres.shape[2]):
                    gap = (fit_x[c] - fit_centres[i, k, c]) * fit_width[i, c]
                    distance += gap * gap
                fit_sigma[k] = np.exp(-0.5 * distance)
            f_o[4] = basis.network(fit_f[i], fit_sigma)
            g_o[4] = basis.network(fit_g[i], fit_sigma)
            if fit_h:
                f_o[4] += f_o[1] - f_o[2]
                g_o[4] += g_o[1] - g_o[2]
            joint_observers(p, x, dx, forms, f_o, g_o, rho, seen, p.l1 * e1o, corr)
            sig[S, i], sig[U, i], sig[U_CMD, i], sig[RHO_TRUE, i] = s, u, told, rho
            sig[F_O, i], sig[G_O, i], sig[E1O, i], sig[E2O, i] = f_o[0], g_o[0], e1o, e2o
            sig[QD, i], sig[VD, i], sig[AD, i] = desired[0, i], desired[1, i], desired[2, i]
        forward_dynamics(q, v, tau, acc)
        for i in range(2):
            dz[i, X1], dz[i, X2] = v[i], acc[i]

    @njit
    def jacobian(
        t: float, z: Any, jac: Any, sig: Any, par: Any, motion: Any, fault: Any, mode: Any,
        forms: Any, fit: Any, work: Any,
    ) -> None:  # fmt: skip
        """∂rates/∂z by forward differences, written to ``jac`` (2 states, 2 states).

        SciPy's own widens its step without end on a state that acts on nothing.
        """
        count = z.shape[1]
        flat = z.reshape(2 * count)
        base, moved = np.empty_like(z), np.empty_like(z)
        rhs(t, z, base, sig, par, motion, fault, mode, forms, fit, work)
        for c in range(2 * count):
            kept = flat[c]
            flat[c] = kept + _STEP * max(abs(kept), 1.0)
            step = flat[c] - kept
            rhs(t, z, moved, sig, par, motion, fault, mode, forms, fit, work)
            flat[c] = kept
            for i in range(2):
                for j in range(count):
                    jac[i * count + j, c] = (moved[i, j] - base[i, j]) / step

    return rhs, jacobian


@functools.cache
def right_hand_side(plant: str) -> tuple[Compiled, Compiled]:
    """Return the compiled right-hand side and its Jacobian.

    Args:
        plant: A name of :data:`dftc_rt.dynamics.closed_form.plants.CLOSED_FORMS`.
    """
    form = CLOSED_FORMS[plant]
    return _build(form.local_terms, form.forward_dynamics)
