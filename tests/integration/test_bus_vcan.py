"""vcan links made and removed for real, and our frames as candump sees them on them."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from dftc_rt.bus.frame import BARRIER_ID, EFF_FLAG
from dftc_rt.bus.rtnetlink import find_link
from dftc_rt.bus.vcan_links import bring_up
from dftc_rt.cli.main import run
from tests.integration import captured
from tests.integration.captured import Frame
from tests.integration.commands import until

pytestmark = pytest.mark.vcan

Lines = pytest.CaptureFixture[str]
LINKS = ("vcan5", "vcan6")


def ip(*arguments: str) -> None:
    subprocess.run(["ip", "link", *arguments], check=True)


@pytest.fixture(autouse=True)
def clean() -> Iterator[None]:
    yield
    for link in LINKS:
        if find_link(link) is not None:
            ip("del", link)


def states() -> list[tuple[str, bool] | None]:
    found = [find_link(link) for link in LINKS]
    return [None if link is None else (link.kind, link.up) for link in found]


def test_up_twice_and_down_twice(capfd: Lines) -> None:
    assert states() == [None, None]
    assert run(["bus", "up", "can5,can6"]) == 0
    assert states() == [("vcan", True), ("vcan", True)]
    assert run(["bus", "up", "can5,can6"]) == 0
    assert states() == [("vcan", True), ("vcan", True)]
    assert run(["bus", "down", "can6"]) == 0
    assert states() == [("vcan", True), None]
    assert run(["bus", "down", "can5,can6"]) == 0
    assert run(["bus", "down", "can5,can6"]) == 0
    assert states() == [None, None]
    assert capfd.readouterr().out.splitlines() == [
        "vcan5: made", "vcan6: made", "vcan5: was up", "vcan6: was up", "vcan6: removed",
        "vcan5: removed", "vcan6: was not there", "vcan5: was not there", "vcan6: was not there",
    ]  # fmt: skip


def test_a_link_that_is_down_is_brought_up(capfd: Lines) -> None:
    ip("add", "vcan5", "type", "vcan")
    assert states() == [("vcan", False), None]
    assert run(["bus", "up", "can5"]) == 0
    assert states() == [("vcan", True), None]
    assert capfd.readouterr().out == "vcan5: brought up\n"


def test_links_for_can_fd_get_its_mtu(capfd: Lines) -> None:
    for link, state in zip(LINKS, ("up", "down"), strict=True):
        ip("add", link, "type", "vcan")
        ip("set", link, "mtu", "16", state)
    assert bring_up(LINKS) == {"vcan5": "was up", "vcan6": "brought up"}
    assert bring_up(LINKS, fd=True) == dict.fromkeys(LINKS, "was up, mtu 16 -> 72")
    assert states() == [("vcan", True), ("vcan", True)]
    assert [getattr(find_link(link), "mtu", None) for link in LINKS] == [72, 72]
    ip("set", "vcan0", "down")
    ip("set", "vcan0", "mtu", "16", "up")
    moteus = ["--set", "bus.profile=moteus", "--set", "robot.joints_per_bus=4"]
    run_it = ["hil", "panda_shoulder_loss", "--bus", "vcan", "--lockstep", *moteus]
    assert run(run_it) == 3
    assert "vcan0 carries classical frames only (mtu 16)" in capfd.readouterr().err
    assert run(["bus", "up", "panda_shoulder_loss", *moteus]) == 0
    assert capfd.readouterr().out == "vcan0: was up, mtu 16 -> 72\nvcan1: was up\n"


@pytest.mark.parametrize("command", ["up", "down"])
def test_a_look_alike_is_never_touched(command: str, capfd: Lines) -> None:
    ip("add", "vcan5", "type", "vxcan", "peer", "name", "peer5")
    ip("add", "vcan6", "type", "vcan")
    assert run(["bus", command, "can6,can5"]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert "vcan5: a link of kind vxcan (expected kind vcan)" in err
    assert states() == [("vxcan", False), ("vcan", False)]


def test_links_made_so_carry_frames() -> None:
    from dftc_rt.bus.socketcan import SocketCanSocket
    from tests.conformance.bus_transports import batch, collect_node

    assert run(["bus", "up", "can5"]) == 0
    one, other = SocketCanSocket("can5", "vcan5"), SocketCanSocket("can5", "vcan5")
    one.send(batch([(0x123, b"abc")]), 1)
    assert collect_node(other, 1) == [(0x123, b"abc")]
    one.close()
    other.close()


@contextmanager
def candump(folder: Path, *links: str) -> Iterator[Path]:
    """Run candump on some links; yield the file that it writes its log to."""
    program = shutil.which("candump")
    assert program, "no candump; apt-get install can-utils"
    path = folder / "candump.log"
    with path.open("wb") as out:
        process = subprocess.Popen(
            [program, "-L", "-r", str(1 << 20), *links], stdout=out, stderr=subprocess.PIPE
        )
        try:
            # It listens once it waits in the kernel for frames or signals.
            until(lambda: _sleeps(process.pid), "candump listens")
            yield path
        finally:
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=30)
            assert not errors, errors


def _sleeps(pid: int) -> bool:
    """Whether a process has all its sockets open and waits."""
    try:
        sockets = [p for p in Path(f"/proc/{pid}/fd").glob("*") if p.readlink().match("socket:*")]
    except FileNotFoundError:  # one was closed meanwhile: it is still starting
        return False
    state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    return len(sockets) >= 1 and state == "S"


LINE = re.compile(r"\((\d+\.\d+)\) (\w+) ([0-9A-F]+)#([0-9A-F]*)(?: [RT])?")


def read_log(path: Path) -> dict[str, list[Frame]]:
    """Return the frames of each link in candump's log, barriers left out."""
    found: dict[str, list[Frame]] = {}
    for line in path.read_text().splitlines():
        match = LINE.fullmatch(line)
        assert match, line
        _, link, identifier, data = match.groups()
        can_id = int(identifier, 16) | (EFF_FLAG if len(identifier) == 8 else 0)
        if can_id != BARRIER_ID:
            found.setdefault(link, []).append((can_id, bytes.fromhex(data)))
    return found


def test_candump_shows_what_was_sent(tmp_path: Path) -> None:
    settings = ["duration_s=0.05", "fault=[]"]
    with candump(tmp_path, "vcan0", "vcan1", "vcan2") as dumped:
        arguments = ["hil", "panda_shoulder_loss", "--bus", "vcan", "--lockstep", "--no-report"]
        overrides = [part for setting in settings for part in ("--set", setting)]
        assert run([*arguments, "--log", str(tmp_path / "there.mcap"), *overrides]) == 0
    there = read_log(dumped)
    # Lock-step: the same run in one process sends the same frames.
    here = captured.run("panda_shoulder_loss", settings, tmp_path / "here.mcap")
    assert sorted(there) == ["vcan0", "vcan1", "vcan2"]
    for tap in here.taps:
        seen, sent = split(there[f"v{tap.name}"]), split(tap.frames)
        assert len(sent[1:]) > 300
        assert dialogue(seen[0]) == dialogue(sent[0])
        assert seen[1:-1] == sent[1:-1]  # every frame of every cycle, in order
        assert seen[-1][: len(sent[-1])] == sent[-1]  # what nobody waits for any more follows


def dialogue(frames: list[Frame]) -> list[Frame]:
    """Return NMT and SDO: what drives say unasked in set-up depends on when their ends start."""
    return [frame for frame in frames if frame[0] == 0 or 0x580 <= frame[0] < 0x680]


def split(frames: list[Frame]) -> list[list[Frame]]:
    """Cut before every SYNC; what precedes the first is set-up."""
    at = [0, *(k for k, (can_id, _) in enumerate(frames) if can_id == captured.SYNC), len(frames)]
    return [frames[i:j] for i, j in pairwise(at)]
