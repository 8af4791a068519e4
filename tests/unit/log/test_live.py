"""What viewers get while a run is recorded, through a WebSocket client of another library."""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from websockets.sync.client import ClientConnection, connect

from dftc_rt.cli.main import run
from dftc_rt.errors import InputError
from dftc_rt.log.live import HOST, check_port
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.schema import CDR_HEADER

from .conftest import SCENARIO, URDF, Sample, frames

TOPICS = {"/cycle", "/rig", "/events", "/joint_states", "/tf", "/robot_description"}
MESSAGE = struct.Struct("<BIQ")  # opcode, subscription, log time; then the payload
DEADLINE_S = 10.0


def free_port() -> int:
    with socket.create_server((HOST, 0)) as probe:
        port: int = probe.getsockname()[1]
        return port


class Viewer:
    """A client that has subscribed to everything."""

    def __init__(self, port: int) -> None:
        self.socket: ClientConnection = connect(
            f"ws://{HOST}:{port}", subprotocols=["foxglove.sdk.v1"]
        )
        self.info = self.told("serverInfo")
        self.channels: dict[int, dict[str, Any]] = {}
        while {each["topic"] for each in self.channels.values()} != TOPICS:
            advertised = self.told("advertise")["channels"]
            self.channels |= {each["id"]: each for each in advertised}
        wanted = [{"id": number, "channelId": number} for number in self.channels]
        self.ask({"op": "subscribe", "subscriptions": wanted})

    def ask(self, message: dict[str, Any]) -> None:
        self.socket.send(json.dumps(message))

    def told(self, op: str) -> dict[str, Any]:
        """The next message of a kind, whatever else comes."""
        while True:
            message = self.socket.recv(DEADLINE_S)
            if isinstance(message, str):
                found: dict[str, Any] = json.loads(message)
                if found["op"] == op:
                    return found

    def payload(self, topic: str) -> bytes:
        """The next payload of a topic, whatever else comes."""
        while True:
            message = self.socket.recv(DEADLINE_S)
            if isinstance(message, bytes):
                _, number, _ = MESSAGE.unpack_from(message)
                if self.channels[number]["topic"] == topic:
                    return message[MESSAGE.size :]


@pytest.fixture
def served(sample: Sample, tmp_path: Path) -> Iterator[tuple[Recorder, int]]:
    port = free_port()
    with Recorder(
        tmp_path / "run.mcap", sample.cycle, sample.rig, scenario=SCENARIO, urdf=URDF,
        link_frames=frames, live_port=port, live_name="dftc x",
    ) as recorder:  # fmt: skip
        yield recorder, port


def subscribed(recorder: Recorder, port: int) -> Viewer:
    """A viewer whose subscription has arrived: the robot is sent on it."""
    viewer = Viewer(port)
    live = recorder._live
    assert live is not None
    while not live.subscribed:
        viewer.socket.ping().wait(DEADLINE_S)
    recorder.flush_due(0.0)
    return viewer


def test_every_topic_is_advertised_and_what_is_logged_arrives(
    served: tuple[Recorder, int], sample: Sample
) -> None:
    recorder, port = served
    viewer = subscribed(recorder, port)
    assert viewer.info["name"] == "dftc x"
    recorder.write_cycles(sample.cycles[:20])
    assert viewer.payload("/cycle") == CDR_HEADER + sample.cycles[0].tobytes()
    definition = {each["topic"]: each["schema"] for each in viewer.channels.values()}
    assert "float64 q_shoulder" in definition["/cycle"]
    recorder.write_cycles(sample.cycles[20:40])
    assert b"elbow.1" in viewer.payload("/joint_states")


def test_the_robot_is_sent_to_whoever_comes_late(
    served: tuple[Recorder, int], sample: Sample
) -> None:
    recorder, port = served
    recorder.write_cycles(sample.cycles[:500])
    for _ in range(2):
        viewer = subscribed(recorder, port)
        assert URDF.encode() in viewer.payload("/robot_description")


def test_a_viewer_can_do_nothing_but_look(served: tuple[Recorder, int]) -> None:
    recorder, port = served
    viewer = subscribed(recorder, port)
    assert viewer.info["capabilities"] == []
    channel = {"id": 1, "topic": "/cycle", "encoding": "cdr", "schemaName": "x"}
    viewer.ask({"op": "advertise", "channels": [channel]})
    assert "does not support" in viewer.told("status")["message"]


def test_the_port_is_closed_with_the_log_and_the_file_is_the_same(
    served: tuple[Recorder, int], sample: Sample, tmp_path: Path
) -> None:
    recorder, port = served
    subscribed(recorder, port)
    recorder.write_cycles(sample.cycles)
    recorder.close()
    with pytest.raises(OSError, match="refused"):
        connect(f"ws://{HOST}:{port}")
    with Recorder(
        tmp_path / "other.mcap", sample.cycle, sample.rig, scenario=SCENARIO, urdf=URDF,
        link_frames=frames,
    ) as other:  # fmt: skip
        other.write_cycles(sample.cycles)
    assert counts(tmp_path / "run.mcap") == counts(tmp_path / "other.mcap")


def counts(path: Path) -> dict[str, int]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    number = summary.statistics.channel_message_counts
    return {channel.topic: number[i] for i, channel in summary.channels.items() if i in number}


def test_a_port_that_is_taken_is_one_line_before_anything_starts(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.create_server((HOST, 0)) as taken:
        port = taken.getsockname()[1]
        assert run(["hil", "ur5_elbow_loss", "--foxglove-port", str(port)]) == 2
    told = capsys.readouterr().err
    assert told == (
        f"dftc: --foxglove-port: port {port} of 127.0.0.1 cannot be opened: "
        "Address already in use (expected a free port)\n"
    )
    assert not list(tmp_path.iterdir())  # no log has been begun
    with pytest.raises(InputError, match="--foxglove-port: 70000"):
        check_port(70000, "--foxglove-port")


def test_a_recorder_that_does_not_get_the_port_goes_on_and_says_so(
    sample: Sample, tmp_path: Path
) -> None:
    with socket.create_server((HOST, 0)) as taken:
        port = taken.getsockname()[1]
        sample.write(tmp_path / "run.mcap", live_port=port)
    found = counts(tmp_path / "run.mcap")
    assert found["/cycle"] == len(sample.cycles)
    assert found["/events"] == 3
