"""Bring your own URDF: does the arm survive a weak joint?

Any fixed-base URDF will do: a path, or a path below example-robot-data. Here the Z1 arm.

    python examples/own_urdf.py [URDF [JOINT]]
"""

import sys
import tempfile
from pathlib import Path

from dftc_rt.analysis.metrics import evaluate
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.dynamics.robot import load_robot

SCENARIO = """
name = "own-urdf"
duration_s = 8.0

[robot]
urdf = "{urdf}"
home_rad = {home}

[reference]
amplitude_rad = 0.1

[[fault]]
joint = "{joint}"
kind = "loss"
start_s = 4.0
effectiveness = 0.6
"""


def main() -> None:
    """Take 40 % off one joint's torque and say how well the arm goes on."""
    urdf = sys.argv[1] if len(sys.argv) > 1 else "z1_description/urdf/z1.urdf"
    robot = load_robot(urdf=urdf)
    joint = sys.argv[2] if len(sys.argv) > 2 else robot.joints[min(1, robot.n - 1)]
    # In the middle of the limits, so that there is room to move.
    home = [
        0.0 if abs(low) == float("inf") else 0.5 * (low + high)
        for low, high in zip(robot.lower.tolist(), robot.upper.tolist(), strict=True)
    ]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "own.toml"
        file.write_text(SCENARIO.format(urdf=urdf, joint=joint, home=home))
        run, outcome = run_simulation(open_session(file))
    found = evaluate(run)["joints"][joint]
    print(f"{robot.name}, {robot.n} joints: {outcome.end_state} {outcome.reason}")
    print(
        f"{joint}: {found['rmse_healthy_mrad']:.2f} mrad RMS before the loss, "
        f"{found['rmse_faulty_mrad']:.2f} after it, {found['peak_after_fault_mrad']:.1f} at worst; "
        f"detected after {found['detection_delay_s']} s"
    )


if __name__ == "__main__":
    main()
