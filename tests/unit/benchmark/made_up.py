"""Rows that nobody measured."""

from __future__ import annotations

from typing import Any

from dftc_rt.benchmark.rows import FaultRow, NegativeRow


def case(number: int = 1, **changed: Any) -> FaultRow:
    """A case in which all went well; ``number`` is its seed."""
    values: dict[str, Any] = {
        "fingerprint": "f", "robot": "ur5", "variant": "dftc", "interconnection": "desired",
        "draw": "tuning", "seed": number, "end_state": "done", "simulated_s": 8.0, "cpu_s": 2.0,
        "kind": "loss40", "joint": "elbow", "loaded": True, "torque_share": 0.2,
        "anomaly_delay_s": 0.05, "attribution_delay_s": 0.4, "anomaly_information_s": 0.01,
        "attribution_information_s": 0.02, "distinct_information_s": 0.3, "evidence_150ms": 90.0,
        "rho_rmse": 0.02, "rho_settle_s": 0.5, "rmse_mrad": 0.4, "rmse_twin_mrad": 0.4,
        "peak_mrad": 5.0, "other_joint": "lift", "other_mrad": 0.11, "other_twin_mrad": 0.1,
        "effort": 1.6, "effort_all": 1.2, "within_2_std": 0.95, "std_over_rmse": 1.5,
        "std_samples": 1000,
    } | changed  # fmt: skip
    name = "/".join(
        str(values[key])
        for key in ("robot", "variant", "interconnection", "draw", "seed", "kind", "joint")
    )
    return FaultRow(**{"id": name} | values)


def healthy(number: int = 1, **changed: Any) -> NegativeRow:
    """An hour without a fault or an alarm."""
    values: dict[str, Any] = {
        "fingerprint": "f", "robot": "ur5", "variant": "dftc", "interconnection": "desired",
        "draw": "tuning", "seed": number, "end_state": "done", "simulated_s": 3600.0,
        "cpu_s": 600.0, "item": "multisine", "worst_mrad": 1.0,
    } | changed  # fmt: skip
    name = f"{values['robot']}/{values['variant']}/{values['interconnection']}/{number}"
    return NegativeRow(**{"id": f"{name}/{values['item']}"} | values)
