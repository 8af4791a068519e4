"""The whole product over the kernel's own virtual CAN: the same bytes as in one process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dftc_rt.cli.hil import hil
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.log.reader import read

WALL_TIME = {"lateness", "compute", "exchange"}
SETTINGS = ["duration_s=0.2", "fault[0].start_s=0.1"]


@pytest.mark.vcan
@pytest.mark.parametrize(
    "scenario", ["panda_shoulder_loss", "paper_example1", "paper_example2", "paper_example2_urdf"]
)
def test_lockstep_over_vcan_gives_the_same_records_as_one_process(
    scenario: str, tmp_path: Path
) -> None:
    log = tmp_path / "vcan.mcap"
    code = hil(scenario, bus="vcan", lockstep=True, log=log, set_=SETTINGS, report=False)
    assert code == 0
    there = read(log)
    here, _ = run_simulation(open_session(scenario, SETTINGS))
    assert there.rig is not None
    assert here.rig is not None
    for mine, theirs in ((here.cycle, there.cycle), (here.rig, there.rig)):
        for name in mine.keys() - WALL_TIME:
            np.testing.assert_array_equal(mine[name], theirs[name], err_msg=name)
    assert (there.rig["fault"] > 0).any()
