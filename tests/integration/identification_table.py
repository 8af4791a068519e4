"""What identified networks add, on motion that neither calibration nor they have seen.

``python -m tests.integration.identification_table DIR`` calibrates and identifies Panda and UR5
with hidden payload and friction (files that are in DIR already are taken), runs both with and
without the networks, and prints the tables of docs/identification.md. A quarter of an hour.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from dftc_rt.analysis.metrics import evaluate
from dftc_rt.cli.main import run as command
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation

HIDDEN = (
    "rig.plant.payload_kg=1.0",
    'rig.plant.friction="lugre"',
    "rig.plant.coulomb_fraction=0.02",
    "rig.plant.viscous_fraction=0.01",
)
ROBOTS = {"panda": "panda_shoulder_loss", "ur5": "ur5_elbow_loss"}
SEEDS = (21, 22, 23)
SECONDS, SETTLED_S = 14.0, 3.0
ELSEWHERE_RAD = 0.4


def sets(*settings: str) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


def prepare(folder: Path, robot: str) -> dict[str, tuple[str, ...]]:
    """Settings of the variants; calibrates and identifies what is not in the folder."""
    scenario = ROBOTS[robot]
    model, networks = folder / f"{robot}.toml", folder / f"{robot}.npz"
    calibrated = (f"control.calibration={model}",)
    if not model.exists():
        assert command(["calibrate", scenario, "-o", str(model), *sets(*HIDDEN)]) == 0
    if not networks.exists():
        given = sets(*HIDDEN, *calibrated)
        assert command(["identify", scenario, "-o", str(networks), *given]) == 0
    used = (*calibrated, f"control.identification={networks}")
    return {
        "calibration alone": calibrated,
        "networks in the observer": used,
        "and in the law": (*used, "control.identification_in_law=true"),
    }


def elsewhere(scenario: str) -> str:
    """Another home pose: every joint moved towards its farther limit."""
    robot = open_session(scenario).robot
    away = np.where(robot.upper - robot.home > robot.home - robot.lower, 1.0, -1.0)
    return f"robot.home_rad={[float(x) for x in robot.home + ELSEWHERE_RAD * away]}"


def measure(scenario: str, settings: tuple[str, ...]) -> dict[str, Any]:
    """Figures of one run."""
    own = (*HIDDEN, f"duration_s={SECONDS}", *settings)
    opened = open_session(scenario, own)
    run, outcome = run_simulation(opened, progress=False)
    start = int(SETTLED_S * opened.scenario.executor.rate_hz)
    residual = np.sqrt(np.mean(run.cycle["residual"][start:] ** 2, axis=0))
    error = np.sqrt(np.mean((run.cycle["q"] - run.cycle["qd"])[start:] ** 2, axis=0))
    joints = evaluate(run)["joints"]
    return {
        "residual": 100.0 * residual / opened.parts.torque_limit,
        "rho": np.sqrt(np.mean((run.cycle["rho_hat"][start:] - 1.0) ** 2, axis=0)),
        "error": 1e3 * error,
        "alarms": sum(each["false_alarms"] for each in joints.values()),
        "faulty": [joints[str(fault.joint)] for fault in opened.scenario.fault],
        "end": outcome.end_state,
    }


def healthy(robot: str, where: str, variants: dict[str, tuple[str, ...]]) -> None:
    for name, settings in variants.items():
        moved = () if where == "home" else (elsewhere(ROBOTS[robot]),)
        runs = [
            measure(ROBOTS[robot], (*settings, *moved, "fault=[]", f"reference.seed={seed}"))
            for seed in SEEDS
        ]
        worst = [np.sqrt(np.mean([r[key] ** 2 for r in runs], axis=0)) for key in
                 ("residual", "rho", "error")]  # fmt: skip
        print(
            f"| {robot}, {where} | {name} | {np.mean(worst[0]):.3f} | {worst[0].max():.3f} "
            f"| {np.mean(worst[1]):.3f} | {worst[1].max():.3f} | {worst[2].max():.2f} "
            f"| {sum(r['alarms'] for r in runs)} | {'/'.join(r['end'] for r in runs)} |",
            flush=True,
        )


def faulty(robot: str, variants: dict[str, tuple[str, ...]]) -> None:
    for name, settings in variants.items():
        runs = [measure(ROBOTS[robot], (*settings, f"reference.seed={seed}")) for seed in SEEDS]
        joints = [each for run in runs for each in run["faulty"]]

        def column(key: str, form: str, joints: list[Any] = joints) -> str:
            return ", ".join("–" if j[key] is None else f"{j[key]:{form}}" for j in joints)

        print(
            f"| {robot} | {name} | {column('rho_rmse', '.3f')} "
            f"| {column('anomaly_delay_s', '.3f')} | {column('detection_delay_s', '.2f')} "
            f"| {column('rmse_faulty_mrad', '.2f')} "
            f"| {sum(r['alarms'] for r in runs)} |",
            flush=True,
        )


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    variants = {robot: prepare(folder, robot) for robot in ROBOTS}
    print("| no fault | law has | y − φ mean | worst | ρ̂ mean | worst | error | alarms | end |")
    for robot in ROBOTS:
        for where in ("home", "elsewhere"):
            healthy(robot, where, variants[robot])
    print("| loss of 40 % | law has | ρ̂ RMSE | anomaly | attributed | error | false alarms |")
    for robot in ROBOTS:
        faulty(robot, variants[robot])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
