"""A row of the results: what is kept of a run, each column with its unit and meaning."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import msgspec


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Columns that every row has; see :data:`COMMON`."""

    id: str
    fingerprint: str
    robot: str
    variant: str
    interconnection: str
    momentum_threshold: float = 1.0
    draw: str
    seed: int
    end_state: str = ""
    reason: str = ""
    simulated_s: float = 0.0
    cpu_s: float = 0.0


class FaultRow(Row, frozen=True, kw_only=True):
    """One case of the grid of faults; see :data:`FAULT_COLUMNS`."""

    kind: str
    joint: str
    second: str = ""
    loaded: bool = False
    beyond: bool = False
    torque_share: float
    anomaly_delay_s: float | None = None
    attribution_delay_s: float | None = None
    anomaly_information_s: float | None = None
    attribution_information_s: float | None = None
    distinct_information_s: float | None = None
    evidence_150ms: float | None = None
    rho_rmse: float | None = None
    rho_settle_s: float | None = None
    rmse_mrad: float | None = None
    rmse_twin_mrad: float | None = None
    peak_mrad: float | None = None
    other_joint: str = ""
    other_mrad: float | None = None
    other_twin_mrad: float | None = None
    false_alarms: int = 0
    false_alarm_s: float = 0.0
    wrong_gain_s: float = 0.0
    effort: float | None = None
    effort_all: float | None = None
    within_2_std: float | None = None
    std_over_rmse: float | None = None
    std_samples: int = 0
    stop_s: float | None = None
    need_s: float | None = None


class NegativeRow(Row, frozen=True, kw_only=True):
    """One run of the negative set; see :data:`NEGATIVE_COLUMNS`."""

    item: str
    false_alarms: int = 0
    false_alarm_s: float = 0.0
    wrong_gain_s: float = 0.0
    anomalies: int = 0
    anomaly_s: float = 0.0
    joints: str = ""
    worst_mrad: float | None = None


class SweepRow(Row, frozen=True, kw_only=True):
    """Alarms of the law ``momentum`` at many thresholds; see :data:`SWEEP_COLUMNS`."""

    item: str
    counts: str


COMMON: Final[Mapping[str, str]] = {
    "id": "name of the case; the same case has the same name in every run of the benchmark",
    "fingerprint": "of the sources and the calibration that the row was made with",
    "robot": "robot",
    "variant": "law; `dftc_gain_off` is the law `dftc` with `control.ftc = false`",
    "interconnection": "`control.interconnection`",
    "momentum_threshold": "factor on the calibrated `threshold_loss` of the law `momentum`",
    "draw": "`tuning` or `sealed`",
    "seed": "of motion and noise",
    "end_state": "`done` or `safe stop`",
    "reason": "of a safe stop",
    "simulated_s": "simulated time, s",
    "cpu_s": "processor time, s",
}
FAULT_COLUMNS: Final[Mapping[str, str]] = {
    **COMMON,
    "kind": "kind of fault; `twin` for the fault-free run, of which every joint has a row",
    "joint": "faulted joint",
    "second": "the other one of kind `two`",
    "loaded": "whether the joint is loaded",
    "beyond": "whether the case is beyond the joint's torque authority",
    "torque_share": "RMS torque of the twin in the faulty window, of the limit",
    "anomaly_delay_s": "from the fault to the first verdict that is no health, s; empty: never",
    "attribution_delay_s": "from the fault to the first verdict actuator loss, s; empty: never",
    "anomaly_information_s": "from the fault to the evidence for an anomaly, s; empty: never",
    "attribution_information_s": "the same for an attribution, s",
    "distinct_information_s": "the same for the loss being distinct from a constant torque, s",
    "evidence_150ms": "evidence 150 ms after the fault, in units of `threshold_anomaly`",
    "rho_rmse": "RMS of ρ̂ - ρ in the faulty window",
    "rho_settle_s": "from the fault to the last time that |ρ̂ - ρ| > 0.05, s",
    "rmse_mrad": "RMS tracking error of the joint in the faulty window, mrad",
    "rmse_twin_mrad": "the same of the twin, mrad",
    "peak_mrad": "largest tracking error of the joint from the fault on, mrad",
    "other_joint": "of the joints without a fault, the one whose error grew by most",
    "other_mrad": "its RMS tracking error in the faulty window, mrad",
    "other_twin_mrad": "the same of the twin, mrad",
    "false_alarms": "entries into verdict actuator loss where it is wrong, all joints",
    "false_alarm_s": "time spent in it, summed over joints, s",
    "wrong_gain_s": "time with ρ̂ < 0.9 acting on a healthy joint, summed over joints, s",
    "effort": "RMS command of the joint in the faulty window over that of the twin",
    "effort_all": "the same over all joints, each in units of its limit",
    "within_2_std": "share of samples with |ρ̂ - ρ| <= 2 rho_std, from 0.5 s after the "
    "attribution, while observable",
    "std_over_rmse": "mean rho_std over RMS of ρ̂ - ρ, same samples",
    "std_samples": "number of these samples",
    "stop_s": "from the fault to the safe stop, s; empty: none",
    "need_s": "from the fault to the first |φ| above the residual's floor, s",
}
NEGATIVE_COLUMNS: Final[Mapping[str, str]] = {
    **COMMON,
    "item": "what moves or disturbs the robot",
    "false_alarms": "entries into verdict actuator loss, all joints",
    "false_alarm_s": "time spent in it, summed over joints, s",
    "wrong_gain_s": "time with ρ̂ < 0.9 acting, summed over joints, s",
    "anomalies": "entries into any verdict that is no health, all joints",
    "anomaly_s": "time spent in them, summed over joints, s",
    "joints": "joints that had a false alarm",
    "worst_mrad": "largest RMS tracking error of a joint, from 2 s on, mrad",
}
SWEEP_COLUMNS: Final[Mapping[str, str]] = {
    **COMMON,
    "item": "what moves or disturbs the robot",
    "counts": "entries into verdict actuator loss at each factor, separated by spaces",
}


def cells(row: Row) -> dict[str, str]:
    """A row as texts: six significant digits, nothing for None."""
    return {name: _text(value) for name, value in msgspec.structs.asdict(row).items()}


def fault_row(found: Mapping[str, str]) -> FaultRow:
    """A row from its texts.

    Raises:
        ValueError: A column is missing or is not what it should be.
    """
    return msgspec.convert(_present(found.items()), FaultRow, strict=False)


def negative_row(found: Mapping[str, str]) -> NegativeRow:
    """A row from its texts.

    Raises:
        ValueError: A column is missing or is not what it should be.
    """
    return msgspec.convert(_present(found.items()), NegativeRow, strict=False)


def sweep_row(found: Mapping[str, str]) -> SweepRow:
    """A row from its texts.

    Raises:
        ValueError: A column is missing or is not what it should be.
    """
    return msgspec.convert(_present(found.items()), SweepRow, strict=False)


def _present(items: Iterable[tuple[str, str]]) -> dict[str, str]:
    return {key: value for key, value in items if value != ""}


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)
