"""``dftc hil --foxglove``: a viewer sees the run while it lasts, and the log lacks nothing."""

from __future__ import annotations

import json
import socket
import struct
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from dftc_rt.log.live import HOST
from dftc_rt.log.reader import read
from tests.integration.commands import ATTEMPTS, DFTC, PATIENT, started
from tests.unit.log.test_live import free_port

pytestmark = pytest.mark.realtime

WANTED = {"/joint_states", "/robot_description", "/cycle"}


def listening(port: int) -> bool:
    """Whether somebody answers at a port of this machine."""
    with socket.socket() as trial:
        return trial.connect_ex((HOST, port)) == 0


def received(viewer: ClientConnection) -> set[str]:
    """Subscribe to what is wanted; return what came of it until the run was over."""
    topics: dict[int, str] = {}
    got: set[str] = set()
    try:
        while True:
            message = viewer.recv(20.0)
            if isinstance(message, bytes):
                got.add(topics[struct.unpack_from("<BI", message)[1]])
                continue
            told = json.loads(message)
            if told["op"] == "advertise":
                new = {each["id"]: each["topic"] for each in told["channels"]}
                topics |= {number: topic for number, topic in new.items() if topic in WANTED}
                wanted = [{"id": number, "channelId": number} for number in new if number in topics]
                viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
    except ConnectionClosed:
        return got


def test_a_viewer_sees_the_run_and_the_log_is_whole(tmp_path: Path) -> None:
    port = free_port()
    for _ in range(ATTEMPTS):
        with started(
            tmp_path / "run", DFTC, "hil", "ur5_elbow_loss", "--bus", "unix", "--no-report",
            *PATIENT, "--set", "duration_s=3", "--log", tmp_path / "run.mcap", "--json",
            "--foxglove-port", str(port),
        ) as run:  # fmt: skip
            run.until_said(f"live: ws://{HOST}:{port}")
            run.until(lambda: listening(port), "the port to open")
            with connect(f"ws://{HOST}:{port}", subprotocols=["foxglove.sdk.v1"]) as viewer:
                got = received(viewer)
            code = run.end()
        if code == 0:
            break
    assert code == 0, run.err
    assert got == WANTED
    found = json.loads(run.out)
    assert not any(found["recorder_dropped"].values())
    assert len(read(tmp_path / "run.mcap").cycle["t"]) == found["cycles"]
