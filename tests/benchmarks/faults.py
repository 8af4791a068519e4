"""The acceptance table: a shoulder or elbow joint loses 40 % of its torque.

Exact model, no friction, ``interconnection = "desired"``. Each run is judged against its
twin: the same scenario, seed and law without the fault, over the same window.
"""

from __future__ import annotations

from typing import Any

from dftc_rt.analysis.metrics import evaluate
from tests.benchmarks.closed_loop import simulate
from tests.benchmarks.result import Aim, Result, Table

CASES = {
    "panda joint 2": ("panda_shoulder_loss", "panda_joint2"),
    "panda joint 4": ("panda_shoulder_loss", "panda_joint4"),
    "ur5 shoulder lift": ("ur5_elbow_loss", "shoulder_lift_joint"),
    "ur5 elbow": ("ur5_elbow_loss", "elbow_joint"),
}
LAWS = {
    "dftc": ["control.law=dftc", "control.ftc=true"],
    "dftc, ftc=false": ["control.law=dftc", "control.ftc=false"],
    "computed_torque (B0)": ["control.law=computed_torque", "control.ftc=false"],
}
_EXACT = [
    "control.interconnection=desired", "rig.plant.viscous=0.0", "rig.plant.coulomb=0.0",
    "rig.plant.payload_kg=0.0",
]  # fmt: skip


def run(quick: bool = False) -> Result:
    """Run every case with every law, and each one's twin.

    Args:
        quick: One case, a short run.
    """
    seconds, start = (3.0, 1.5) if quick else (20.0, 6.0)
    cases = list(CASES)[:1] if quick else list(CASES)
    rows: list[tuple[str | float | None, ...]] = []
    aims: list[Aim] = []
    for case in cases:
        scenario, joint = CASES[case]
        errors: dict[str, float] = {}
        for law, chosen in LAWS.items():
            found = _judge(scenario, joint, [*_EXACT, *chosen, f"duration_s={seconds}"], start)
            own = found["joints"][joint]
            errors[law] = own["rmse_faulty_mrad"]
            rows.append(
                (
                    case, law, own["rmse_faulty_mrad"], own["rmse_twin_mrad"], _over_twin(own),
                    max(_over_twin(m) for name, m in found["joints"].items() if name != joint),
                    own["rho_rmse"], own["detection_delay_s"],
                    sum(m["false_alarms"] for m in found["joints"].values()),
                )
            )  # fmt: skip
        b0 = errors["computed_torque (B0)"] / errors["dftc"]
        aims.append(Aim(f"{case}: RMSE of B0 with the same gains over dftc", ">=", 3.0, b0))
    header = (
        "case", "law", "RMSE, mrad", "twin, mrad", "x twin", "other joints, worst x twin",
        "rho RMSE", "detected after, s", "false alarms",
    )  # fmt: skip
    title = (
        f"Faults: effectiveness 0.6 from {start:g} s of {seconds:g} s; "
        f"tracking of the faulted joint from {start + 0.5:g} s on"
    )
    return Result("faults", [Table(title, header, rows)], aims)


def _judge(scenario: str, joint: str, settings: list[str], start: float) -> dict[str, Any]:
    fault = f'fault=[{{joint="{joint}", kind="loss", start_s={start}, effectiveness=0.6}}]'
    faulted = simulate(scenario, [*settings, fault])
    twin = simulate(scenario, [*settings, "fault=[]"])
    return evaluate(faulted.run, twin=twin.run)


def _over_twin(joint: dict[str, Any]) -> float:
    return float(joint["rmse_faulty_mrad"] / joint["rmse_twin_mrad"])
