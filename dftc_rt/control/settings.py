"""Every gain and setting of the laws: name, default, printed value, unit, meaning, bounds.

``[control.gains]`` of a scenario is parsed here; docs/notation.md lists the same table.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dftc_rt.control.interface import F64
from dftc_rt.errors import InputError

INF: Final = math.inf
LARGEST: Final = 1e15
"""Largest setting that is not meant to be none at all: products of a few of them stay finite.

Thresholds of sums of likelihoods, as the benchmark sets them, come to 1e13.
"""
Value = float | int | bool | str | Sequence[Any]


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting.

    Attributes:
        name: Key in ``[control.gains]``.
        default: Value of the law ``dftc``.
        printed: Value of the law ``paper``.
        unit: Unit, "1" when dimensionless.
        meaning: What it does, with the equation.
        low: Smallest accepted value.
        high: Largest accepted value.
        choices: Names of an enumerated setting, in the order of their integer values.
    """

    name: str
    default: float
    printed: float
    unit: str
    meaning: str
    low: float = 0.0
    high: float = INF
    choices: tuple[str, ...] = ()


NUMBERS: Final[tuple[Setting, ...]] = (
    # law
    Setting("lam", 25.0, 5.0, "1/s", "λ of the sliding variable (4)"),
    Setting("k", 25.0, 10.0, "1/s", "feedback gain k of (10)"),
    Setting("delay_phase", 1.0, INF, "rad", "λ, k are lowered at set-up until ω_c T is below it"),
    Setting("layer", 0.3, 0.0, "rad/s", "boundary layer of sgn(s) in (10); 0: exact sgn"),
    Setting("dead_zone", 0.03, 0.0, "rad/s", "|s| below it does not feed (13), (14)"),
    Setting("s_bound", 10.0, INF, "1", "bound on S = 1 + |s| + s²"),
    Setting("gamma_f", 0.0, 0.002, "rad/s²", "Γ_f of (11)"),
    Setting("gamma_g", 0.0, 0.002, "1", "Γ_g of (12)"),
    Setting("gamma_delta", 2.0, 500.0, "1/s", "Γ_δ of (13)"),
    Setting("gamma_xi", 2.0, 400.0, "1/s", "Γ_ξ of (14)"),
    Setting("leak_f", 0.1, 0.0, "1/s", "leakage of Ŵ_f"),
    Setting("leak_g", 0.1, 0.0, "1/s", "leakage of Ŵ_g"),
    Setting("leak_delta", 1.0, 0.0, "1/s", "leakage of δ̂"),
    Setting("leak_xi", 1.0, 0.0, "1/s", "leakage of ξ̂"),
    Setting("w_f_max", 20.0, INF, "rad/s²", "bound on each weight of Ŵ_f, Ŵ_fo"),
    Setting("w_g_max", 0.2, INF, "1", "bound on each weight of Ŵ_g, Ŵ_go"),
    Setting("delta_max", 1.0, INF, "rad/s²", "bound on δ̂"),
    Setting("xi_max", 1.0, INF, "rad/s²", "bound on ξ̂"),
    Setting("g_min", 0.7, -INF, "1", "least ĝ M", -INF),
    Setting("g_max", 1.4, INF, "1", "largest ĝ M"),
    # basis
    Setting("basis_width", 1.0, 0.5, "1", "b: grid, in grid spacings; diagonal, in rad", 1e-6),
    # identifier
    Setting("l1", 40.0, 40.0, "1/s", "l_1 of (18)", 0.5),
    Setting("l2", 100.0, 100.0, "1/s", "l_2 of (18)", 0.5),
    Setting("gamma_fo", 0.002, 0.002, "rad/s²", "Γ_fo of (21)"),
    Setting("gamma_go", 0.002, 500.0, "1", "Γ_go of (22)"),
    Setting("gamma_delta_o", 2.0, 500.0, "1/s", "Γ_δo of (23); 500 is ours, the paper is silent"),
    Setting("leak_o", 0.1, 0.0, "1/s", "leakage of the identifier's weights and δ̂_o"),
    Setting("layer_o", 0.3, 0.0, "rad/s", "boundary layer of sgn(e_2o) in (18)"),
    Setting("dead_zone_o", 0.03, 0.0, "rad/s", "|e_2o| below it does not feed (23)"),
    Setting("delta_o_max", 1.0, INF, "rad/s²", "bound on δ̂_o"),
    Setting("x1o_offset", 0.0, 0.0, "rad", "x̂_1 - x_1 at the start", -INF),
    Setting("x2o_offset", 0.0, 0.0, "rad/s", "x̂_2 - x_2 at the start", -INF),
    # observer
    Setting("gamma_rho", 1000.0, 2000.0, "1/s²", "Γ_ρ of (29), normalised in `gradient`"),
    Setting("l1f", 30.0, 30.0, "1/s", "l_1f of (28)", 0.5),
    Setting("l2f", 60.0, 30.0, "1/s", "l_2f of (28)", 0.5),
    Setting("bandwidth", 80.0, 80.0, "rad/s", "filter of φ and y", 1e-3),
    Setting("torque_lag_s", 0.001, 0.001, "s", "first-order lag of the drive's torque"),
    Setting("floor_nm", 0.1, 0.1, "Nm", "residual floor, absolute part"),
    Setting("floor_fraction", 0.007, 0.007, "1", "residual floor, fraction of the torque limit"),
    Setting("excitation", 3.0, 3.0, "1", "ρ̂ is held while |φ| is below this many floors"),
    Setting("velocity_noise", 0.002, 0.002, "rad/s", "standard deviation of measured velocity"),
    Setting("sigma_acc", 0.02, 0.02, "1", "relative error of M q̈_d"),
    Setting("sigma_transient", 0.5, 0.5, "1", "relative error of M (q̈ - q̈_d), filtered"),
    Setting("sigma_bias", 0.01, 0.01, "1", "relative error of the bias torque"),
    Setting("sigma_friction", 0.005, 0.005, "1", "friction error at v = 0, of the torque limit"),
    Setting("v_friction", 0.05, 0.05, "rad/s", "velocity over which it fades", 1e-6),
    Setting("inflation", 40.0, 40.0, "1", "variance inflation for coloured residuals", 1e-6),
    Setting("walk", 0.05, 0.05, "1/√s", "random walk of ρ while healthy"),
    Setting("walk_fault", 0.3, 0.3, "1/√s", "random walk of ρ under an anomaly or a loss"),
    Setting("rls_memory_s", 0.2, 0.2, "s", "memory of the estimator `rls`", 1e-3),
    Setting("rho_std_max", 0.3, 0.3, "1", "standard deviation of ρ̂ at the start, and its bound"),
    Setting("std_scale", 0.65, 0.65, "1", "on the filter's standard deviation, as it is logged"),
    Setting("warmup_s", 0.2, 0.0, "s", "nothing is estimated before this time"),
    # decision
    Setting("rho_step", 0.2, 0.2, "1", "CUSUM tests ρ = 1 ∓ this against 1", 0.01, 0.99),
    Setting("threshold_anomaly", 6.0, 6.0, "1", "CUSUM that makes an anomaly"),
    Setting("threshold_loss", 15.0, 15.0, "1", "CUSUM that makes an actuator loss"),
    Setting("rho_loss", 0.92, 0.92, "1", "ρ̂ of an actuator loss is below this", 0.0, 1.0),
    Setting("rho_clear", 0.95, 0.95, "1", "ρ̂ from which a loss is taken to have ended", 0.0, 1.0),
    Setting("clear_s", 0.5, 0.5, "s", "time that ρ̂ must stay there"),
    # attribution
    Setting("residual_step", 2.5, 2.5, "1", "a residual of this many σ is an anomaly", 0.1),
    Setting("attribution_s", 0.2, 0.2, "s", "an anomaly is not attributed before this time"),
    Setting("attribution_margin", 4.0, 4.0, "1", "by this much an explanation must be better"),
    Setting("load_fraction", 0.04, 0.04, "1", "a loss needs torque above this part of the limit"),
    Setting("load_std_kg", 2.0, 2.0, "kg", "size of payload changes", 1e-3),
    Setting("attribution_window_s", 1.0, 1.0, "s", "memory of the explanations", 0.05),
    Setting("probe", 0.02, 0.0, "1", "test torque of an anomaly, of the limit; 0: none", 0.0, 0.1),
    Setting("probe_s", 0.3, 0.3, "s", "length of a test", 0.1, 0.6),
    Setting("probe_wait_s", 0.1, 0.1, "s", "time from an anomaly to its first test"),
    Setting("sensor_gap_rad", 0.01, 0.01, "rad", "position against velocity, over 0.1 s", 1e-6),
    Setting("slope_std", 0.3, 0.3, "1/s", "change of a disturbance, in torque limits", 1e-3),
    Setting("compensation", 0.3, 0.0, "1", "most torque added while unattributed, of the limit"),
    Setting("compensation_rate", 5.0, 0.0, "1/s", "its largest slope, in torque limits"),
    # baselines
    Setting("momentum_bandwidth", 100.0, 100.0, "rad/s", "K of the law `momentum`", 1e-3),
    Setting("momentum_memory_s", 0.05, 0.05, "s", "memory of its regression of ρ", 1e-6),
    Setting("eso_ratio", 10.0, 10.0, "1", "ω of the law `eso` over √(k λ)", 1e-3),
    Setting("gamma_theta", 7e4, 7e4, "1/s²", "γ u_max²/M_ii of the law `adaptive`"),
    Setting("dead_zone_theta", 0.008, 0.008, "rad/s", "|s| below it does not feed its θ̂"),
    # gain
    Setting("rho_min", 0.15, 0.01, "1", "least ρ̂ in the gain (33)", 0.01, 1.0),
    Setting("rho_max", 1.0, INF, "1", "largest ρ̂ in the gain (33)", 1.0),
    Setting("gain_rate", 20.0, INF, "1/s", "largest slope of the gain"),
)
CHOICES: Final[tuple[Setting, ...]] = (
    Setting("model", 0, 1, "", "f̂, ĝ from the split plus RBF, or RBF alone", 0, 1,
            ("split", "rbf")),
    Setting("layer_shape", 0, 0, "", "shape of the boundary layer", 0, 1, ("sat", "tanh")),
    Setting("freeze_saturated", 1, 0, "", "no adaptation while the command is saturated", 0, 1,
            ("off", "on")),
    Setting("identifier", 0, 1, "", "identifier (18): not run, adapting, or frozen", 0, 2,
            ("off", "adapt", "frozen")),
    Setting("observer", 0, 2, "", "estimator of ρ", 0, 3, ("kalman", "gradient", "printed", "rls")),
    Setting("observer_correction", 0, 1, "", "identifier terms inside (28)", 0, 1, ("off", "on")),
    Setting("attribution", 0, 0, "", "what makes an actuator loss of an anomaly", 0, 1,
            ("cusum", "hypotheses")),
    Setting("gain_gate", 0, 1, "", "gain (33) after an actuator loss was decided, or always",
            0, 1, ("attributed", "always")),
    Setting("momentum_gate", 1, 1, "", "gain of the law `momentum`: as gain_gate, or of every ρ̂",
            0, 1, ("attributed", "always")),
    Setting("eso_model", 1, 1, "", "what the law `eso` knows: friction, or all local terms", 0, 1,
            ("none", "split")),
    Setting("eso_velocity", 1, 1, "", "velocity that the law `eso` feeds back: z2, or measured",
            0, 1, ("estimated", "measured")),
)  # fmt: skip
SHAPE: Final[tuple[Setting, ...]] = (
    Setting("basis", 0, 1, "", "centres: grid over the joint's range, or the paper's diagonal",
            0, 1, ("grid", "diagonal")),
    Setting("grid_q", 9, 9, "", "grid points along the position", 1, 99),
    Setting("grid_v", 5, 5, "", "grid points along the velocity", 1, 99),
)  # fmt: skip
WEIGHTS: Final[dict[str, str]] = {
    "w_f": "rad/s²",
    "w_g": "1",
    "w_fo": "rad/s²",
    "w_go": "1",
}
"""Initial weights Ŵ_f, Ŵ_g, Ŵ_fo, Ŵ_go: scalar, (m,) or (n, m)."""

NAMES: Final = tuple(s.name for s in NUMBERS + CHOICES + SHAPE) + tuple(WEIGHTS)


@dataclass(frozen=True, slots=True)
class Settings:
    """Parsed settings of n joints.

    Attributes:
        values: Per-joint values, (n,) each, by name; enumerated ones as int64.
        shape: Values common to all joints: ``basis``, ``grid_q``, ``grid_v``.
        weights: Initial weights as given, by name; absent ones are the law's own.
    """

    values: dict[str, np.ndarray[Any, Any]]
    shape: dict[str, int]
    weights: dict[str, F64]


def parse(gains: Mapping[str, Value], n: int, *, printed: bool) -> Settings:
    """Check and complete the gains of a law.

    Args:
        gains: Keys of :data:`NAMES`; a value is a scalar, a list of n, or a choice's name.
        n: Number of joints.
        printed: Complete with the paper's printed values instead of the defaults.

    Raises:
        InputError: A key is unknown, a value is out of bounds, not a number, or a list does
            not have n entries.
    """
    unknown = sorted(set(gains) - set(NAMES))
    if unknown:
        near = difflib.get_close_matches(unknown[0], NAMES, n=3)
        expected = " or ".join(f"'{name}'" for name in near) or "one of those in docs/notation.md"
        raise InputError(f"control.gains.{unknown[0]}", "unknown key", expected)
    values: dict[str, np.ndarray[Any, Any]] = {}
    for setting in NUMBERS + CHOICES:
        start = setting.printed if printed else setting.default
        given = gains.get(setting.name)
        numbers = _numbers(setting, given, n) if given is not None else np.full(n, start)
        values[setting.name] = numbers.astype(np.int64) if setting.choices else numbers
    shape: dict[str, int] = {}
    for setting in SHAPE:
        start = setting.printed if printed else setting.default
        shape[setting.name] = int(_one(setting, gains.get(setting.name, start)))
    weights = {name: _weights(name, gains[name]) for name in WEIGHTS if name in gains}
    return Settings(values, shape, weights)


def _numbers(setting: Setting, given: Value, n: int) -> F64:
    """Scalar or list of n, as (n,)."""
    if isinstance(given, list | tuple | np.ndarray):
        if len(given) != n:
            raise InputError(
                f"control.gains.{setting.name}", f"{len(given)} values", f"a scalar or {n} values"
            )
        return np.array([_one(setting, item) for item in given])
    return np.full(n, _one(setting, given))


def _one(setting: Setting, given: Any) -> float:
    """One value of a setting, checked."""
    where = f"control.gains.{setting.name}"
    whole = bool(setting.choices) or setting in SHAPE
    if isinstance(given, str) and given in setting.choices:
        return float(setting.choices.index(given))
    if setting.choices and isinstance(given, bool) and setting.choices == ("off", "on"):
        return float(given)
    if isinstance(given, bool | str) or not isinstance(given, int | float | np.number):
        expected = " | ".join(setting.choices) or f"a number in {setting.unit or '1'}"
        raise InputError(where, repr(given), expected)
    low, high = max(setting.low, -LARGEST), min(setting.high, LARGEST)
    unbounded = INF in (setting.default, setting.printed) and given == INF
    if not (unbounded or low <= given <= high) or (whole and given != int(given)):
        expected = " | ".join(setting.choices) or f"{low:g} to {high:g}"
        raise InputError(where, f"{given!r}", expected)
    return float(given)


def _weights(name: str, given: Any) -> F64:
    """Initial weights as an array of at most two dimensions."""
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"control.gains.{name}", repr(given), "numbers") from error
    if array.ndim > 2 or not np.all(np.abs(array) <= LARGEST):
        expected = f"numbers up to {LARGEST:g}: scalar, (m,) or (n, m)"
        raise InputError(f"control.gains.{name}", repr(given), expected)
    return array
