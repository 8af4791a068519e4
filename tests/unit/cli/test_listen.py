"""``dftc control --listen``: the verdict, on buses that the test plays."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from dftc_rt.bus import link_kind
from dftc_rt.bus.can_link import CanLink
from dftc_rt.bus.error_frames import state_frame
from dftc_rt.bus.frame import frame_buffer, pack
from dftc_rt.bus.unix import UnixSocket
from dftc_rt.cli import listen as listening
from dftc_rt.cli.listen import listen
from dftc_rt.cli.listen_show import as_json, show
from dftc_rt.cli.main import run
from dftc_rt.cli.session import Session, open_session

PANDA = "panda_shoulder_loss"
NODES = {0: (1, 2, 3), 1: (4, 5), 2: (6, 7)}
HEARTBEATS = {bus: [pack(0x700 + n, b"\x7f") for n in nodes] for bus, nodes in NODES.items()}


@pytest.fixture(scope="module")
def opened() -> Session:
    return open_session(PANDA)


class Buses:
    """Three buses on which a test says what it likes, before anybody listens."""

    def __init__(self) -> None:
        self.pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in NODES]
        self.ends = [UnixSocket(f"can{k}", near) for k, (near, _) in enumerate(self.pairs)]

    def say(self, bus: int, *raws: bytes) -> None:
        for raw in raws:
            self.pairs[bus][1].send(raw)

    def all_heartbeats(self) -> None:
        for bus, raws in HEARTBEATS.items():
            self.say(bus, *raws)

    def sent(self) -> int:
        """How many frames the listener has sent."""
        total = 0
        for k, (_, far) in enumerate(self.pairs):
            if self.ends[k].fd >= 0:
                total += UnixSocket(f"can{k}", far).receive(frame_buffer(64))
        return total

    def close(self) -> None:
        for near, far in self.pairs:
            near.close()
            far.close()


@pytest.fixture
def buses() -> Iterator[Buses]:
    made = Buses()
    yield made
    made.close()


def against(opened: Session, buses: Buses, ask: bool = False) -> list[str]:
    return listen(opened, buses.ends, 0.05, ask=ask).against


def test_every_drive_heard_and_nothing_sent(
    opened: Session, buses: Buses, capsys: pytest.CaptureFixture[str]
) -> None:
    buses.all_heartbeats()
    heard = listen(opened, buses.ends, 0.05, ask=False)
    assert show(heard, json=False) == 0
    out = capsys.readouterr().out
    assert out.endswith("verdict: 7 of 7 drives heard; nothing conflicts\n")
    assert "0x701" in out
    assert "pre-operational" in out
    assert buses.sent() == 0


def test_a_drive_that_is_missing(
    opened: Session, buses: Buses, capsys: pytest.CaptureFixture[str]
) -> None:
    buses.all_heartbeats()
    heard = listen(opened, buses.ends, 0.05, ask=False)
    assert heard.against == []
    quiet = Buses()
    quiet.say(0, *HEARTBEATS[0])
    quiet.say(2, *HEARTBEATS[2], HEARTBEATS[1][0])
    heard = listen(opened, quiet.ends, 0.05, ask=False)
    assert show(heard, json=False) == 1
    quiet.close()
    assert heard.against == [
        "panda_joint4 (node 4 on can1): not heard",
        "panda_joint5 (node 5 on can1): not heard",
        "can2: node 4 is here; panda_joint4 should be on can1",
    ]
    assert "verdict: 5 of 7 drives heard; do not start\n" in capsys.readouterr().out


def test_somebody_else_at_work(opened: Session, buses: Buses) -> None:
    buses.all_heartbeats()
    buses.say(0, pack(0x080, b"\x01"), pack(0x201, bytes(4)), pack(0x080, b"\x02"))
    assert against(opened, buses, ask=True) == [
        "can0: somebody else talks to these drives: SYNC, RPDO1 to panda_joint1",
        "no drive was asked, for that",
    ]
    assert buses.sent() == 0


def test_an_interface_in_trouble(opened: Session, buses: Buses) -> None:
    buses.all_heartbeats()
    buses.say(1, state_frame("passive", 128))
    assert against(opened, buses) == ["can1: the interface is error passive"]


def test_a_bus_that_goes_away(opened: Session, buses: Buses) -> None:
    buses.all_heartbeats()
    buses.pairs[2][1].close()
    assert against(opened, buses) == ["can2: the bus has gone away (closed by its owner)"]


def test_strangers_that_leave_no_room(opened: Session, buses: Buses) -> None:
    buses.all_heartbeats()
    buses.say(0, *[pack(0x7E0, bytes(8))] * 20)  # 20 frames in 50 ms: some 5 % beside our 89 %
    (line,) = against(opened, buses)
    assert line.startswith("can0: other nodes take ")
    assert line.endswith("ours up to 89%: more than 90%")


def test_the_words_of_a_drive(opened: Session, buses: Buses) -> None:
    buses.all_heartbeats()
    buses.say(0, pack(0x081, b"\x30\x81\x11"), pack(0x282, b"\x23\x00\x0a"))
    found = as_json(listen(opened, buses.ends, 0.05, ask=False))
    said = {each["joint"]: each["said"] for each in found["drives"]}
    assert "1 emergencies, the last 0x8130" in said["panda_joint1"]
    assert "switched on" in said["panda_joint2"]
    assert msgspec.json.decode(msgspec.json.encode(found))["ok"] is True
    ids = {each["identifier"]: each for each in found["buses"][0]["identifiers"]}
    assert ids["0x701"]["speaker"] == "drive"
    assert ids["0x701"]["bytes"] == 1


@pytest.mark.parametrize(
    ("can", "line"),
    [
        (CanLink(bitrate=500_000), "set to 500000 bit/s, the scenario says 1000000"),
        (CanLink(bitrate=1_000_000, state="bus-off"), "the interface is bus-off"),
        (CanLink(modes=("listen-only",)), "the interface is set to listen-only"),
    ],
)
def test_an_interface_that_is_set_up_wrongly(
    can: CanLink, line: str, opened: Session, buses: Buses, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = listening._bus

    def with_link(*arguments: Any) -> listening.HeardBus:
        made = make(*arguments)
        made.can = can if made.name == "can0" else None
        return made

    monkeypatch.setattr(listening, "_bus", with_link)
    buses.all_heartbeats()
    assert against(opened, buses) == [f"can0: {line}"]


@pytest.mark.parametrize(
    ("options", "where"),
    [
        (["--ask"], "--ask"),
        (["--duration", "1"], "--duration"),
        (["--listen", "--lockstep"], "--listen"),
        (["--listen", "--duration", "0"], "--duration"),
        (["--listen", "--duration", "nan"], "--duration"),
    ],
)
def test_options_that_mean_nothing(
    options: list[str], where: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run(["control", PANDA, "--bus", "unix", *options]) == 2
    err = capfd.readouterr().err
    assert err.startswith(f"dftc: {where}: ")
    assert err.count("\n") == 1


def test_mit_drives_cannot_be_asked(buses: Buses) -> None:
    from dftc_rt.errors import InputError

    mit = open_session(PANDA, ["bus.profile=mit"])
    with pytest.raises(InputError, match="--ask"):
        listen(mit, buses.ends, 0.05, ask=True)


def test_the_kernel_is_not_asked_about_what_is_no_link(
    opened: Session, buses: Buses, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(name: str) -> None:
        raise AssertionError(name)

    monkeypatch.setattr(link_kind, "find_link", fail)
    buses.all_heartbeats()
    assert against(opened, buses) == []
