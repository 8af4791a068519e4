"""The whole product over the kernel's own virtual CAN: the same bytes as in one process."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.analysis import load
from dftc_rt.bus.frame import ERR_FLAG
from dftc_rt.bus.socketcan import SocketCanSocket
from dftc_rt.cli import control
from dftc_rt.cli.hil import hil
from dftc_rt.cli.listen import listen
from dftc_rt.cli.listen_show import as_json, show
from dftc_rt.cli.main import run as run_command
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation
from dftc_rt.log.reader import read
from tests.conformance.bus_transports import batch
from tests.integration import commands
from tests.integration.commands import DFTC, Started, gone, started, until

WALL_TIME = {"lateness", "compute", "exchange"}
pytestmark = pytest.mark.vcan

# User-Mode Linux is no place for a kilohertz: slow cycles, and nobody is impatient. CiA 402 drives
# would be: they miss the heartbeat after 150 ms, whatever the scenario says.
SLOW = [
    part
    for setting in (
        "bus.profile=mit", "executor.rate_hz=50", "duration_s=600", "fault=[]",
        "control.law=computed_torque",
        "reference.kind=hold",
        "supervisor.tracking_error_rad=3", "supervisor.stale_cycles=1000",
        "supervisor.saturation_s=100", "supervisor.rho_min=0.001", "rig.drive.watchdog_s=5",
    )
    for part in ("--set", setting)
]  # fmt: skip
# Locked memory of three processes is more than that machine has, and it has one core.
HUMBLE = ("setpriv", "--bounding-set", "-ipc_lock,-sys_nice", "--inh-caps", "-ipc_lock,-sys_nice")
PANDA = "panda_shoulder_loss"
SETTINGS = ["duration_s=0.2", "fault[0].start_s=0.1"]


@pytest.mark.parametrize(
    "scenario", ["panda_shoulder_loss", "paper_example1", "paper_example2", "paper_example2_urdf"]
)
def test_lockstep_over_vcan_gives_the_same_records_as_one_process(
    scenario: str, tmp_path: Path
) -> None:
    as_in_one_process(scenario, SETTINGS, tmp_path / "vcan.mcap")


def test_frames_of_a_run_over_vcan_are_those_of_one_process(tmp_path: Path) -> None:
    here, there = tmp_path / "here.mcap", tmp_path / "there.mcap"
    set_ = [part for setting in SETTINGS for part in ("--set", setting)]
    assert run_command(["simulate", PANDA, "--frames", "--log", str(here), *set_]) == 0
    over_vcan = ["hil", PANDA, "--bus", "vcan", "--lockstep", "--frames", "--no-report"]
    assert run_command([*over_vcan, "--log", str(there), *set_]) == 0
    cans = [load(log).can for log in (here, there)]
    of_loop = [can.records[can.records["t"] >= 0.0] for can in cans if can is not None]
    for bus in range(3):  # between the buses of a cycle there is no order
        one, other = (records[records["bus"] == bus] for records in of_loop)
        assert len(one) > 200 * 4
        assert one.tobytes() == other.tobytes()


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


@pytest.mark.parametrize("profile", ["cia402", "mit", "moteus"])
def test_faults_of_the_bus_over_vcan_likewise(profile: str, tmp_path: Path) -> None:
    faults = (
        'fault=[{bus="can0", kind="frame_duplication", probability=0.2},'
        ' {bus="can0", kind="frame_delay", delay_s=0.0015, probability=0.2},'
        ' {bus="can1", kind="bus_off", joint="panda_joint4", start_s=0.1, end_s=0.11}]'
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
    ip(link, "down")
    ip(link, "mtu", str(mtu), "up")


@pytest.fixture
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "DEADLINE_S", 240.0)


@pytest.fixture
def running(tmp_path: Path, patience: None) -> Iterator[Started]:
    """A run in real time on three vcan links."""
    arguments = ["hil", PANDA, "--bus", "vcan", "--no-report", *SLOW]
    with started(
        tmp_path / "run", *HUMBLE, DFTC, *arguments, "--log", tmp_path / "run.mcap"
    ) as process:
        try:
            process.until_running()
        except TimeoutError:
            pytest.fail(process.err)
        yield process


def ip(*arguments: str) -> None:
    subprocess.run(["ip", "link", "set", *arguments], check=True)


def test_an_interface_that_goes_down_ends_the_run_in_order(
    running: Started, tmp_path: Path
) -> None:
    pids = list(running.children().values())
    assert len(pids) == 3
    ip("vcan1", "down")
    try:
        assert running.end() == 1
    finally:
        ip("vcan1", "up")
    until(lambda: all(gone(pid) for pid in pids), "the children to end")
    lines = running.err.splitlines()
    assert "safe stop: bus lost: can1 (vcan1): the interface went down" in lines, running.err
    assert "Traceback" not in running.err
    there = read(tmp_path / "run.mcap")
    assert any("quick stop: bus lost: can1 (vcan1)" in event.text for event in there.events)
    # And it has come up again: the next run is as any other.
    log = tmp_path / "again.mcap"
    assert hil(PANDA, bus="vcan", lockstep=True, log=log, set_=SETTINGS, report=False) == 0


def test_an_interface_that_goes_down_and_comes_up_at_once_ends_the_run_too(
    running: Started, tmp_path: Path
) -> None:
    """What a node missed meanwhile nobody knows: there is no way back into the run."""
    ip("vcan1", "down")
    ip("vcan1", "up")
    assert running.end() == 1
    assert "safe stop: bus lost: can1 (vcan1): the interface went down" in running.err
    assert "Traceback" not in running.err
    there = read(tmp_path / "run.mcap")
    states = there.cycle["state"].astype(int)
    assert states[-1] == 6  # fault: it did not run on when the link was back
    assert not there.cycle["tau_cmd"][states == 6].any()


def test_an_interface_that_says_bus_off_ends_the_run(running: Started, tmp_path: Path) -> None:
    driver = SocketCanSocket("can2", "vcan2")
    driver.send(batch([(ERR_FLAG | 0x040, bytes(8))]), 1)
    assert running.end() == 1
    driver.close()
    (line,) = [line for line in running.err.splitlines() if line.startswith("safe stop: ")]
    assert line.startswith("safe stop: can2: bus-off, vcan2 took itself off the bus")
    assert "ip link set vcan2 type can restart-ms 100" in line
    there = read(tmp_path / "run.mcap")
    assert any(e.source == "can2" and e.text == "bus-off" for e in there.events)


def test_listening_says_what_is_on_the_links(capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["control", PANDA, "--bus", "socketcan:vcan0,vcan1,vcan2", "--listen"]
    assert run_command([*arguments, "--duration", "0.2"]) == 1
    out = capfd.readouterr().out
    assert "can1: vcan1: vcan, up, mtu 72" in out
    assert "panda_joint1 (node 1 on can0): not heard" in out
    opened = open_session(PANDA)
    ends = control._join(opened, PANDA, "vcan", None, listen=True)
    nodes = [SocketCanSocket(f"can{k}", f"vcan{k}") for k in range(3)]
    for bus, members in enumerate(((1, 2, 3), (4, 5), (6, 7))):
        frames = [(0x700 + node, b"\x7f") for node in members]
        nodes[bus].send(batch(frames), len(frames))
    heard = listen(opened, ends, 0.2, ask=False)
    assert show(heard, json=False) == 0
    found = as_json(heard)
    assert found["buses"][0]["link"]["kind"] == "vcan"
    assert [bus["frames"] for bus in found["buses"]] == [3, 2, 2]
    for end in (*ends, *nodes):
        end.close()
