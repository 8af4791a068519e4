"""What fault tolerance buys: one run with it, one without, one with computed torque.

Writes docs/images/weak_shoulder.png, the figure in the README, and prints the table beside it.

    python examples/weak_shoulder.py [SCENARIO]
"""

import sys
from pathlib import Path

from dftc_rt.analysis.figures import fault_figure, save
from dftc_rt.analysis.metrics import evaluate
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation

FIGURE = Path(__file__).parents[1] / "docs" / "images" / "weak_shoulder.png"

VARIANTS = {
    "dftc": [],
    "dftc, gain off": ["control.ftc=false"],
    "computed torque": ["control.law=computed_torque"],
}


def main() -> None:
    """Run the variants and their twin without the fault; print, and draw."""
    scenario = sys.argv[1] if len(sys.argv) > 1 else "panda_shoulder_loss"
    runs = {}
    print(
        f"{'law':18}{'joint':>14}{'healthy/mrad':>14}{'fault/mrad':>12}{'twin/mrad':>11}{'peak/mrad':>11}"
    )
    for label, settings in VARIANTS.items():
        run, _ = run_simulation(open_session(scenario, settings))
        twin, _ = run_simulation(open_session(scenario, [*settings, "fault=[]"]))
        runs[label] = run
        found = evaluate(run, twin=twin)
        name = found["faults"][0]["joint"]
        joint = found["joints"][name]
        print(
            f"{label:18}{name:>14}{joint['rmse_healthy_mrad']:14.3f}"
            f"{joint['rmse_faulty_mrad']:12.3f}{joint['rmse_twin_mrad']:11.3f}"
            f"{joint['peak_after_fault_mrad']:11.2f}"
        )
    main_run = runs.pop("dftc")
    save(fault_figure(main_run, others=runs, label="dftc"), FIGURE)
    print(f"wrote {FIGURE}")


if __name__ == "__main__":
    main()
