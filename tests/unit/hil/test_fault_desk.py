"""Faults that come while the rig runs: what is taken, what is refused, what is told."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dftc_rt.config.faults import Fault, FrameLossFault, LossFault
from dftc_rt.errors import InputError
from dftc_rt.fault_socket import SOCKET, Answer
from hil.fault_desk import FaultDesk


class Desk:
    """A desk whose rig only remembers."""

    def __init__(self, directory: Path, scenario: Sequence[Fault] = ()) -> None:
        self.faults: list[Fault] = list(scenario)
        self.events: list[tuple[float, int, str, str]] = []
        self.desk = FaultDesk(directory, scenario, self.change, lambda *e: self.events.append(e))
        self.client = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.client.bind("")
        self.client.connect(str(directory / SOCKET))
        self.client.settimeout(5.0)

    def change(self, faults: Sequence[Fault]) -> None:
        if any(getattr(fault, "joint", None) == "nobody" for fault in faults):
            raise InputError("fault[0].joint", "no joint 'nobody'")
        self.faults = list(faults)

    def ask(self, request: object, t: float) -> Answer:
        raw = request if isinstance(request, bytes) else msgspec.json.encode(request)
        self.client.send(raw)
        self.desk.take(t)
        return msgspec.json.decode(self.client.recv(1024), type=Answer)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(tmp_path)
    yield made
    made.client.close()
    made.desk.close()
    assert not list(tmp_path.iterdir())


def loss(effectiveness: float, **more: object) -> dict[str, object]:
    fault = {"kind": "loss", "joint": "a", "effectiveness": effectiveness, **more}
    return {"do": "apply", "fault": fault}


def test_times_count_from_when_it_is_asked(desk: Desk) -> None:
    answer = desk.ask(loss(0.6, start_s=1.0, end_s=3.0), 10.0)
    assert answer == Answer(t=10.0, text="loss on a from 11.000 s")
    assert desk.faults == [LossFault(joint="a", effectiveness=0.6, start_s=11.0, end_s=13.0)]


def test_the_same_kind_on_the_same_joint_is_replaced_and_others_are_not(desk: Desk) -> None:
    desk.ask(loss(0.6), 1.0)
    desk.ask({"do": "apply", "fault": {"kind": "bias", "joint": "a", "torque_nm": 2.0}}, 2.0)
    desk.ask(loss(0.3), 3.0)
    assert sorted(type(fault).__name__ for fault in desk.faults) == ["BiasFault", "LossFault"]
    (left,) = [fault for fault in desk.faults if isinstance(fault, LossFault)]
    assert left.effectiveness == 0.3


def test_clear_ends_what_is_active_and_forgets_what_has_not_begun(tmp_path: Path) -> None:
    begun = LossFault(joint="a", effectiveness=0.5, start_s=1.0)
    later = LossFault(joint="b", effectiveness=0.5, start_s=9.0)
    bus = FrameLossFault(bus="can0", probability=0.1)
    made = Desk(tmp_path, [begun, later, bus])
    made.ask({"do": "clear"}, 4.0)
    assert made.faults == [msgspec.structs.replace(begun, end_s=4.0)]
    assert [text.split(": ")[0] for _, _, _, text in made.events] == ["fault cleared"] * 2
    assert "no such fault is active" in made.ask({"do": "clear"}, 5.0).refused
    made.client.close()
    made.desk.close()


def test_clear_of_one_joint_leaves_the_others(desk: Desk) -> None:
    desk.ask(loss(0.6), 1.0)
    desk.ask(loss(0.6, joint="b"), 1.0)
    desk.ask({"do": "clear", "joint": "a"}, 2.0)
    assert {fault.joint: fault.end_s for fault in desk.faults if isinstance(fault, LossFault)} == {
        "a": 2.0,
        "b": 1e9,
    }


@pytest.mark.parametrize(
    "raw",
    [
        b"", b"\xff", b"{", b"[]", b"null", b'{"do":"stop"}', b'{"do":"apply"}',
        b'{"do":"apply","fault":{"kind":"loss","joint":"a","effectiveness":1.5}}',
        b'{"do":"apply","fault":{"kind":"loss","joint":"a","effectiveness":"1"}}',
        b'{"do":"apply","fault":{"kind":"loss","joint":"a","effectiveness":NaN}}',
        b'{"do":"apply","fault":{"kind":"loss","joint":"a","effectiveness":1,"more":1}}',
        b'{"do":"apply","fault":{"kind":"loss","joint":"nobody","effectiveness":1}}',
        b'{"do":"apply","fault":{"kind":"frame_loss","bus":"can0","probability":1}}',
        b'{"do":"clear","joint":3}', b"{" + b" " * 5000, b"[" * 1000,
    ],
)  # fmt: skip
def test_what_is_no_good_is_refused_in_one_line_and_changes_nothing(desk: Desk, raw: bytes) -> None:
    answer = desk.ask(raw, 1.0)
    assert answer.refused
    assert "\n" not in answer.refused
    assert desk.desk.refused == 1
    assert desk.faults == []
    assert desk.events == []


def test_one_request_a_cycle_and_nobody_is_waited_for(desk: Desk) -> None:
    for share in (0.1, 0.2, 0.3):
        desk.client.send(msgspec.json.encode(loss(share)))
    desk.client.close()  # nobody takes the answers
    seen = []
    for t in (1.0, 2.0, 3.0, 4.0):
        desk.desk.take(t)
        seen.append([f.effectiveness for f in desk.faults if isinstance(f, LossFault)])
    assert seen == [[0.1], [0.2], [0.3], [0.3]]


def test_only_so_many_at_a_time(desk: Desk) -> None:
    for k in range(64):
        assert not desk.ask(loss(0.5, joint=f"j{k}"), 1.0 + k).refused
    assert "64 at a time" in desk.ask(loss(0.5), 100.0).refused
    desk.ask({"do": "clear"}, 101.0)
    assert not desk.ask(loss(0.5), 200.0).refused


def test_the_socket_is_its_users_alone(desk: Desk, tmp_path: Path) -> None:
    assert (tmp_path / SOCKET).stat().st_mode & 0o777 == 0o600
    assert np.isfinite(desk.ask(loss(0.5), 1.0).t)
