"""Read a log into NumPy arrays: what the controller knew, and what was true.

python examples/read_log.py [LOG]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from dftc_rt.cli.simulate import simulate
from dftc_rt.log.reader import read


def main() -> None:
    """Print how well the effectiveness was estimated, cycle by cycle."""
    if len(sys.argv) > 1:
        run = read(sys.argv[1])
    else:
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "run.mcap"
            simulate("ur5_elbow_loss", log=log, set_=["duration_s=8"])
            run = read(log)
    cycle, rig = run.cycle, run.rig
    assert rig is not None, "a log of real drives has no truth in it"
    count = min(len(cycle["t"]), len(rig["t"]))
    error = cycle["rho_hat"][:count] - rig["rho"][:count]
    print(
        f"{count} cycles of {len(run.joints)} joints, t = {cycle['t'][0]} … {cycle['t'][-1]:.3f} s"
    )
    for joint, column in zip(run.joints, error.T, strict=True):
        print(f"{joint:24} worst error of the estimated effectiveness {np.abs(column).max():.3f}")
    for event in run.events:
        print(f"{event.t:8.3f} s  {event.source}: {event.text}")


if __name__ == "__main__":
    main()
