"""Flat storage of a law: one record of parameters and one of states per joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dftc_rt.control import attribution, basis, probe
from dftc_rt.control.interface import F64, Struct
from dftc_rt.control.settings import CHOICES, NUMBERS, Settings
from dftc_rt.errors import InputError

W_F: Final = 0
W_G: Final = 1
W_FO: Final = 2
W_GO: Final = 3
"""Rows of the weights (n, 4, m)."""

_DERIVED: Final = (
    "period", "limit", "resolution", "counts", "alpha", "lag_mean", "lag_decay", "floor",
    "noise", "inv_width1", "inv_width2", "probe_size",
)  # fmt: skip
_DERIVED_INT: Final = ("delay", "use_basis", "warmup", "adapt_f", "ftc", "probe_length")

PARAMETERS: Final = np.dtype(
    [(s.name, np.float64) for s in NUMBERS]
    + [(name, np.float64) for name in _DERIVED]
    + [(s.name, np.int64) for s in CHOICES]
    + [(name, np.int64) for name in _DERIVED_INT],
    align=True,
)

_FLOATS: Final = (
    "delta", "xi", "gain",  # law: δ̂, ξ̂ in rad/s², gain (33)
    "x1o", "x2o", "delta_o",  # identifier (18), (23)
    "x1fo", "x2fo",  # printed observer (28)
    "rho", "rho_var", "momentum_error",  # ρ̂, P, ε in Nm s
    "v_last", "m_last", "b_last", "applied", "phi_sum",  # regression: last sample, drive torque
    "q_last", "gap_q",  # position against velocity, rad
    "y_f", "phi_f", "gap_f", "need_f",  # filtered y, φ in Nm, q̈ - q̈_d in rad/s², torque of q̈_d
    "loss", "excess", "more", "less", "clear_for", "verdict",  # decision
    "load_f", "friction_f", "added",  # filtered regressors, compensation in Nm
    "h_loss", "h_load",  # explanations: 1 - ρ, kg
    "ev_loss", "ev_load", "ev_add", "ev_held", "misfit",  # their evidence, nats; best misfit
    "load_not_loss", "add_not_loss",
    "e_square", "window", "effort", "since", "spare",
    "mass", "held_for",  # load taken into the model, kg
    "low_for", "low_phi", "low_pp", "low_py",  # without any torque: time, φ then, sums of growth
    "probe_g_re", "probe_g_im", "probe_re", "probe_im", "probe_std", "probe_level",
    "probe_evidence", "probe_other", "probe_wait", "drift",
)  # fmt: skip
_INTEGERS: Final = (
    "cycle", "elapsed", "saturated", "active", "handing",
    "probe_at", "probe_count", "probe_tries", "probe_slow",
)  # fmt: skip
STATE: Final = np.dtype(
    [(name, np.float64) for name in _FLOATS] + [(name, np.int64) for name in _INTEGERS],
    align=True,
)


@dataclass(frozen=True, slots=True)
class Storage:
    """Arrays of one law.

    Attributes:
        parameters: (n,) of :data:`PARAMETERS`.
        state: (n,) of :data:`STATE`.
        weights: Ŵ_f, Ŵ_g, Ŵ_fo, Ŵ_go, (n, 4, m).
        initial_weights: Their values at the start.
        centres: (n, m, 2), rad and rad/s.
        sigma: Scratch for σ(x), (m,).
        history: Commands sent, (n, length), Nm, a ring over the cycle number.
        moments: Of the explanations of an anomaly, (n, 7, 7).
        correlations: Of the test torque, (n, longest, 7).
        sums: Of running tests, (n, 2, 6).
    """

    parameters: Struct
    state: Struct
    weights: F64
    initial_weights: F64
    centres: F64
    sigma: F64
    history: F64
    moments: F64
    correlations: F64
    sums: F64


@dataclass(frozen=True, slots=True)
class Joints:
    """What a law must know of the robot and its drives, (n,) each.

    Attributes:
        period_s: Control period, s.
        torque_limit: Largest torque, Nm.
        torque_resolution: Step of the drive's torque, Nm; 0 for none.
        delay_cycles: Cycles from a command to the SYNC that actuates it.
        q_lower: Lower position limits, rad.
        q_upper: Upper position limits, rad.
        velocity_limit: rad/s.
    """

    period_s: float
    torque_limit: F64
    torque_resolution: F64
    delay_cycles: np.ndarray[tuple[int, ...], np.dtype[np.int64]]
    q_lower: F64
    q_upper: F64
    velocity_limit: F64


def allocate(settings: Settings, joints: Joints, *, ftc: bool) -> Storage:
    """Turn settings into the arrays of a kernel.

    Raises:
        InputError: Initial weights do not fit the basis.
    """
    n = joints.torque_limit.shape[0]
    h = joints.period_s
    par = np.zeros(n, dtype=PARAMETERS)
    for name, values in settings.values.items():
        par[name] = values
    par["period"] = h
    par["limit"] = joints.torque_limit
    par["resolution"] = joints.torque_resolution
    safe = np.where(joints.torque_resolution > 0.0, joints.torque_resolution, 1.0)
    par["counts"] = np.floor(joints.torque_limit / safe + 1e-9)
    par["delay"] = joints.delay_cycles
    par["alpha"] = -np.expm1(-par["bandwidth"] * h)
    lags = par["torque_lag_s"] > 0.0
    lag = np.where(lags, par["torque_lag_s"], h)
    par["lag_decay"] = np.where(lags, np.exp(-h / lag), 0.0)
    par["lag_mean"] = np.where(lags, lag / h * -np.expm1(-h / lag), 0.0)
    par["floor"] = par["floor_nm"] + par["floor_fraction"] * joints.torque_limit
    par["noise"] = par["velocity_noise"] * par["bandwidth"]
    par["warmup"] = np.ceil(par["warmup_s"] / h - 1e-9).astype(np.int64)
    par["ftc"] = int(ftc)
    correlations, par["probe_length"] = probe.table(n, h, par["probe_s"])
    bounded = np.isfinite(joints.torque_limit)  # a share of no limit is no torque
    par["probe"] = np.where(bounded, par["probe"], 0.0)
    amplitude = par["probe"] * np.where(bounded, joints.torque_limit, 0.0)
    par["probe_size"] = probe.sizes(correlations) * amplitude
    centres = _centres(settings, joints, par)
    weights = np.zeros((n, 4, centres.shape[1]))
    for row, name in enumerate(("w_f", "w_g", "w_fo", "w_go")):
        if name in settings.weights:
            weights[:, row, :] = _fit(name, settings.weights[name], n, centres.shape[1])
    learns = np.stack([par["gamma_f"], par["gamma_g"]]).any(axis=0)
    identifies = par["identifier"] == 1
    par["adapt_f"] = learns
    par["use_basis"] = learns | identifies | weights.any(axis=(1, 2)) | (par["model"] == 1)
    return Storage(
        parameters=par,
        state=np.zeros(n, dtype=STATE),
        weights=weights.copy(),
        initial_weights=weights,
        centres=centres,
        sigma=np.zeros(centres.shape[1]),
        history=np.zeros((n, int(joints.delay_cycles.max()) + 2)),
        moments=np.zeros((n, attribution.MOMENTS, attribution.MOMENTS)),
        correlations=correlations,
        sums=np.zeros((n, *probe.SUMS)),
    )


def _centres(settings: Settings, joints: Joints, par: Struct) -> F64:
    """Centres of the basis; its inverse widths go into ``par``."""
    if settings.shape["basis"] == 1:
        par["inv_width1"] = 1.0 / par["basis_width"]
        par["inv_width2"] = 1.0 / par["basis_width"]
        return basis.diagonal_centres(par.shape[0])
    count_q, count_v = settings.shape["grid_q"], settings.shape["grid_v"]
    span_q = (joints.q_upper - joints.q_lower) / max(count_q - 1, 1)
    span_v = 2.0 * joints.velocity_limit / max(count_v - 1, 1)
    par["inv_width1"] = 1.0 / (par["basis_width"] * span_q)
    par["inv_width2"] = 1.0 / (par["basis_width"] * span_v)
    return basis.grid_centres(
        joints.q_lower, joints.q_upper, joints.velocity_limit, count_q, count_v
    )


def _fit(name: str, given: F64, n: int, m: int) -> F64:
    """Broadcast initial weights to (n, m)."""
    try:
        return np.broadcast_to(given, (n, m))
    except ValueError as error:
        raise InputError(
            f"control.gains.{name}", f"shape {given.shape}", f"scalar, ({m},) or ({n}, {m})"
        ) from error
