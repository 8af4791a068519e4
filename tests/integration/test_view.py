"""The page of a run in a real browser: what is seen, what is clicked, and who is refused."""

from __future__ import annotations

import lzma
import os
import re
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from numpy.typing import NDArray
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from dftc_rt.analysis.metrics import evaluate
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.dynamics.visuals import Mesh, Visuals
from dftc_rt.log.reader import read
from dftc_rt.view.scene import FIELD_OF_VIEW, camera
from tests.integration.chromium import Browser, chromium
from tests.integration.commands import DFTC, PATIENT, Started, gone, started, until

pytestmark = pytest.mark.realtime

LOG = Path(__file__).parents[1] / "logs" / "panda_calibrated.mcap.xz"
LOADED = "shoulder_lift_joint"
UINT8 = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Started]:
    """A healthy run with its page."""
    with started(
        tmp_path / "run", DFTC, "hil", "ur5_elbow_loss", "--view", "--bus", "unix", "--no-report",
        *PATIENT, "--set", "fault=[]", "--set", "duration_s=600", "--log", tmp_path / "run.mcap",
        "--set", "supervisor.overruns_in_a_row=1000",
        "--set", "reference.amplitude_rad=0.05",
    ) as found:  # fmt: skip
        found.until_said("view: http")
        found.until_running()
        yield found


def address(run: Started) -> str:
    return re.findall(r"view: (http://\S+)", run.err)[0]


def drawn(seen: UINT8) -> Mask:
    """Pixels of something solid: neither white, nor a line of the floor, nor panel or warning."""
    solid = seen.min(axis=2) < 235
    lines = np.lib.stride_tricks.sliding_window_view(np.pad(solid, 2), (5, 5))
    solid = lines.all(axis=(2, 3))
    solid[:, 650:] = False
    solid[:220, :330] = False
    return solid


def expected(shape: tuple[int, int], margin: int) -> Mask:
    """Pixels that points of the UR5's meshes at home fall on, and ``margin`` around them."""
    robot = load_robot("ur5")
    visuals = Visuals(robot)
    poses = np.empty((robot.n, 7))
    visuals.poses(robot.home, poses)
    weights = np.array([(a, b, 6 - a - b) for a in range(7) for b in range(7 - a)]) / 6.0
    points = []
    for visual in visuals.shapes:
        assert isinstance(visual.shape, Mesh)
        corners = visual.shape.vertices[visual.shape.faces]  # (T, 3, 3)
        spread = (weights @ corners).reshape(-1, 3)
        own = turned(visual.quaternion, spread) + visual.translation
        if visual.joint >= 0:
            own = turned(poses[visual.joint, 3:], own) + poses[visual.joint, :3]
        points.append(own)
    look_at, position, _ = camera(poses)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    relative = np.concatenate(points) - position
    scale = 0.5 * shape[0] / np.tan(0.5 * FIELD_OF_VIEW) / (relative @ forward)
    columns = (0.5 * shape[1] + scale * (relative @ right)).astype(int)
    rows = (0.5 * shape[0] - scale * (relative @ np.cross(right, forward))).astype(int)
    mask = np.zeros(shape, bool)
    mask[rows, columns] = True
    size = 2 * margin + 1
    around = np.lib.stride_tricks.sliding_window_view(np.pad(mask, margin), (size, size))
    found: Mask = around.any(axis=(2, 3))
    return found


def turned(quaternion: NDArray[np.float64], points: NDArray[Any]) -> NDArray[np.float64]:
    """Points, (K, 3), turned by a quaternion w x y z."""
    w, u = quaternion[0], quaternion[1:]
    twice = 2.0 * np.cross(u, points)
    return np.asarray(points + w * twice + np.cross(u, twice))


def test_a_fault_from_the_page_acts_is_found_and_a_safe_stop_stops(
    run: Started, tmp_path: Path
) -> None:
    with chromium(tmp_path) as browser:
        browser.open(address(run))
        browser.until_said("faults")
        browser.until_said(LOADED)
        looks_like_a_robot(browser)
        browser.choose("joint", LOADED)
        before = row(browser, LOADED)
        assert before[2] == "1.00", before  # true effectiveness
        browser.click("apply 40 % loss")
        browser.until(lambda: row(browser, LOADED)[2] == "0.60", "the true effectiveness")
        browser.until(lambda: "loss on " + LOADED in browser.text, "the rig's answer")
        browser.until(lambda: abs(float(row(browser, LOADED)[1]) - 0.6) < 0.05, "the estimate")
        browser.until(lambda: row(browser, LOADED)[3] == "actuator loss", "the verdict")
        browser.click("clear")
        browser.until(lambda: row(browser, LOADED)[2] == "1.00", "the fault to end")
        assert browser.outside() == []
        assert browser.blocked == []
        pids = list(run.children().values())
        browser.click("safe stop")
        assert run.end() == 130, run.err
        assert "Traceback" not in run.err
        until(lambda: all(gone(pid) for pid in pids), "the children to end")
    logged = read(tmp_path / "run.mcap")
    assert 5.0 in logged.cycle["state"]  # came to rest under control
    assert logged.rig is not None
    assert np.all(logged.rig["v"][-1] == 0.0)
    texts = [event.text for event in logged.events if event.source == "rig"]
    assert sum(text.startswith("fault applied: ") for text in texts) == 1
    assert sum(text.startswith("fault cleared: ") for text in texts) == 1
    judged = evaluate(logged)  # the fault is known to the analysis, though the scenario has none
    (fault,) = judged["faults"]
    assert (fault["joint"], fault["kind"], fault["effectiveness"]) == (LOADED, "loss", 0.6)
    assert fault["end_s"] < 600
    assert judged["joints"][LOADED]["detection_delay_s"] is not None


def looks_like_a_robot(browser: Browser) -> None:
    """What is drawn has the silhouette of the robot's meshes, to 15 pixels: it moves a little."""
    browser.until(lambda: drawn(browser.screenshot()).sum() > 2000, "a robot to be drawn")
    seen = drawn(browser.screenshot())
    inside = expected(seen.shape, 15)
    corners = expected(seen.shape, 0) & (np.arange(seen.shape[1]) < 640)
    assert seen.sum() > 0.2 * inside.sum()
    assert inside[seen].mean() > 0.95  # what is drawn is robot
    size = np.lib.stride_tricks.sliding_window_view(np.pad(seen, 15), (31, 31))
    assert size.any(axis=(2, 3))[corners].mean() > 0.95  # and all of the robot is drawn


def row(browser: Browser, joint: str) -> list[str]:
    """Error, estimate, truth and verdict of a joint, as the page's table has them."""
    found = browser.evaluate(
        "[...document.querySelectorAll('tr')].map(r => [...r.cells].map(c => c.innerText.trim()))"
    )
    rows = [cells[1:] for cells in found if cells and cells[0] == joint]
    return rows[0] if rows else ["", "", "", ""]


def test_nobody_acts_without_the_token(run: Started) -> None:
    url = address(run)
    authority, token = re.findall(r"http://([^/]+)/\?token=(\S+)", url)[0]
    host, port = authority.split(":")
    assert host == "127.0.0.1"
    assert len(token) > 40
    listening = {
        line.split()[1]
        for line in Path("/proc/net/tcp").read_text().splitlines()[1:]
        if line.split()[3] == "0A" and line.split()[1].endswith(f":{int(port):04X}")
    }
    assert listening == {f"0100007F:{int(port):04X}"}  # loopback, and nothing else
    wrong = token[:-1] + ("A" if token[-1] != "A" else "B")
    for path in ("", "index.html", "?token=", f"?token={wrong}", wrong, f"..%2f{token}"):
        with pytest.raises(HTTPError) as refused:
            urlopen(f"http://{authority}/{path}", timeout=30)
        refused.value.close()
        assert refused.value.code == 403, path
        with pytest.raises(InvalidStatus) as shut:
            connect(f"ws://{authority}/{path}", subprotocols=["viser-v1.1.1"]).close()  # type: ignore[list-item]
        assert shut.value.response.status_code == 403, path
    with urlopen(url, timeout=30) as page:
        assert page.status == 200
        assert "connect-src 'self' ws://127.0.0.1:" in page.headers["Content-Security-Policy"]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_page_that_dies_or_stands_still_is_told_once_and_the_run_goes_on(
    run: Started, number: signal.Signals, tmp_path: Path
) -> None:
    pids = run.children()
    os.kill(pids["dftc-view"], number)
    log = tmp_path / "run.mcap"
    size = log.stat().st_size
    run.until(lambda: log.stat().st_size > size + 400_000, "the run to go on")
    run.process.send_signal(signal.SIGINT)
    assert run.end() == 130, run.err
    assert run.err.count("the run goes on without its page") == 1
    until(lambda: all(gone(pid) for pid in pids.values()), "the children to end")
    logged = read(log)
    assert {3.0, 5.0} <= set(logged.cycle["state"])


def test_a_flood_of_nonsense_is_refused_and_the_run_goes_on(run: Started, tmp_path: Path) -> None:
    (place,) = re.findall(r"\(sockets in (\S+)\)", run.err)
    where = Path(place) / "faults@rig"
    assert where.stat().st_mode & 0o777 == 0o600
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
        own.connect(str(where))
        for k in range(300):
            own.send((b"\xff{", b"", b"[1]", b'{"do":"apply"}', b"x" * 5000)[k % 5])
    run.process.send_signal(signal.SIGINT)
    assert run.end() == 130, run.err
    assert "Traceback" not in run.err
    logged = read(tmp_path / "run.mcap")
    assert not [event for event in logged.events if event.text.startswith("fault")]


def test_a_log_is_played_back_at_the_time_of_the_slider(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    log.write_bytes(lzma.decompress(LOG.read_bytes()))
    run = read(log)
    with started(tmp_path / "run", DFTC, "view", log) as view:
        view.until(lambda: "http://" in view.out, "the address")
        with chromium(tmp_path) as browser:
            browser.open(view.out.split()[0])
            browser.until_said("playback")
            first = run.joints[0]
            browser.until(lambda: row(browser, first)[0] != "", "the table")
            browser.type("time / s", "2.0")
            browser.until(lambda: "t 2.0 s" in browser.text, "the slider's time")
            k = int(np.searchsorted(run.cycle["t"], 2.0 + 1e-9, side="right")) - 1
            for i, joint in enumerate(run.joints):
                assert row(browser, joint)[1] == f"{run.cycle['rho_hat'][k, i]:.2f}"
            assert browser.outside() == []
        view.process.send_signal(signal.SIGINT)
        assert view.end() == 0
        assert "Traceback" not in view.err
