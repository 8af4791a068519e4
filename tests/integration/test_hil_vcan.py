"""The whole product over the kernel's own virtual CAN: the same bytes as in one process."""

from __future__ import annotations

import subprocess
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
    as_in_one_process(scenario, SETTINGS, log)


@pytest.mark.vcan
@pytest.mark.parametrize(
    "settings",
    [
        ["bus.profile=mit"],
        ["bus.profile=moteus", "robot.joints_per_bus=4"],  # the links carry CAN FD: mtu 72
        ["bus.profile=moteus", "robot.joints_per_bus=7", "executor.rate_hz=500"],
    ],
)
def test_drives_without_sync_over_vcan_likewise(settings: list[str], tmp_path: Path) -> None:
    as_in_one_process("panda_shoulder_loss", [*SETTINGS, *settings], tmp_path / "vcan.mcap")


@pytest.mark.vcan
@pytest.mark.parametrize("profile", ["cia402", "mit", "moteus"])
def test_faults_of_the_bus_over_vcan_likewise(profile: str, tmp_path: Path) -> None:
    faults = (
        'fault=[{bus="can0", kind="frame_duplication", probability=0.2},'
        ' {bus="can0", kind="frame_delay", delay_s=0.0015, probability=0.2},'
        ' {bus="can1", kind="bus_off", joint="panda_joint4", start_s=0.1, end_s=0.12}]'
    )
    settings = ["duration_s=0.2", "supervisor.stale_cycles=100", f"bus.profile={profile}", faults]
    as_in_one_process("panda_shoulder_loss", settings, tmp_path / "vcan.mcap", faulty=False)


def as_in_one_process(
    scenario: str, settings: list[str], log: Path, *, faulty: bool = True
) -> None:
    """Run over vcan and in one process; compare all records but the wall times.

    Args:
        scenario: Name.
        settings: Overrides.
        log: Of the run over vcan.
        faulty: Whether a joint has a fault in it.
    """
    for number in range(3):
        set_mtu(f"vcan{number}", 72)
    code = hil(scenario, bus="vcan", lockstep=True, log=log, set_=settings, report=False)
    assert code == 0
    there = read(log)
    here, _ = run_simulation(open_session(scenario, settings))
    assert there.rig is not None
    assert here.rig is not None
    for mine, theirs in ((here.cycle, there.cycle), (here.rig, there.rig)):
        for name in mine.keys() - WALL_TIME:
            np.testing.assert_array_equal(mine[name], theirs[name], err_msg=name)
    assert (there.rig["fault"] > 0).any() == faulty


def set_mtu(link: str, mtu: int) -> None:
    """Let a link carry CAN FD frames."""
    subprocess.run(["ip", "link", "set", link, "down"], check=True)
    subprocess.run(["ip", "link", "set", link, "mtu", str(mtu), "up"], check=True)
