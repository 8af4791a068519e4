"""Two nodes back to back: what a program that uses python-can relies on, over several interfaces.

``virtual`` is python-can's own, so the expectations are not ours alone; ``socketcan`` needs a
kernel with AF_CAN, which ``tests/uml/run.sh`` brings.
"""

from __future__ import annotations

import functools
import os
import pty
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from dftc_rt.bus.directory import BusDirectory
from dftc_rt.bus.frame import frame_buffer
from hil.bus.unix import UnixPort, listen

pytestmark = pytest.mark.realtime

PATIENCE_S = 20.0
Connect = Callable[..., can.BusABC]


class Served:
    """The user-space bus, served by a thread as the rig's loop would."""

    def __init__(self, directory: Path) -> None:
        self.claim = BusDirectory(directory)
        self.port = UnixPort("can0", listen(self.claim.path, "can0"))
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        inbox = frame_buffer(64)
        while not self._end.is_set():
            select.select(self.port.fds(), [], [], 0.01)
            self.port.receive(inbox)

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self.port.close()
        self.claim.release()


@pytest.fixture(
    params=[
        "dftc",
        "virtual",
        pytest.param("socketcan", marks=pytest.mark.vcan),
    ]
)
def connect(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Connect]:
    """Joins one more node to a bus of its own."""
    interface: str = request.param
    monkeypatch.setenv("DFTC_BUS_DIR", str(tmp_path / "buses"))
    served = Served(tmp_path / "buses") if interface == "dftc" else None
    channel = {"dftc": "can0", "socketcan": "vcan0"}.get(interface, str(tmp_path))
    joined: list[can.BusABC] = []

    def join(**options: Any) -> can.BusABC:
        node = can.Bus(interface=interface, channel=channel, **options)
        joined.append(node)
        if served is not None:  # the rig has to have seen it before it hears others
            for _ in range(1000):
                if served.port.statistics.clients == len(joined):
                    break
                time.sleep(0.005)
        return node

    yield join
    for node in joined:
        node.shutdown()
    if served is not None:
        served.close()


@pytest.fixture
def pair(connect: Connect) -> tuple[can.BusABC, can.BusABC]:
    return connect(), connect()


def heard(node: can.BusABC) -> can.Message:
    message = node.recv(PATIENCE_S)
    assert message is not None
    return message


def message(can_id: int = 0x123, data: bytes = b"\x01\x02", **fields: Any) -> can.Message:
    return can.Message(
        arbitration_id=can_id, data=data, **{"is_extended_id": can_id > 0x7FF, **fields}
    )


@pytest.mark.parametrize(
    "sent",
    [
        message(0x0, b""),
        message(0x7FF, bytes(range(8))),
        message(0x800, b"\xff"),
        message(0x1FFF_FFFF - 2, bytes(8)),
        message(0x12, b"\x55", is_extended_id=True),
        message(0x321, b"", is_remote_frame=True, dlc=4),
        message(0x18FF_0001, b"", is_remote_frame=True, dlc=8),
    ],
    ids=lambda sent: f"{sent.arbitration_id:x}-{'r' if sent.is_remote_frame else 'd'}{sent.dlc}",
)
def test_a_message_arrives_as_it_was_sent(
    pair: tuple[can.BusABC, can.BusABC], sent: can.Message
) -> None:
    one, other = pair
    one.send(sent)
    got = heard(other)
    assert got.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
    if one.channel != "vcan0":  # the kernel calls every frame from this host a sent one
        assert got.is_rx
    assert not got.is_error_frame


def test_both_ways_in_order(pair: tuple[can.BusABC, can.BusABC]) -> None:
    one, other = pair
    for sender, receiver in (pair, (other, one)):
        for k in range(50):
            sender.send(message(0x100 + k % 3, bytes([k])))
        assert [heard(receiver).data[0] for _ in range(50)] == list(range(50))


def test_nobody_hears_himself_unless_he_asks(connect: Connect) -> None:
    one, other = connect(receive_own_messages=True), connect()
    one.send(message(0x5))
    assert heard(other).arbitration_id == 0x5
    own = heard(one)
    assert own.arbitration_id == 0x5
    assert not own.is_rx
    other.send(message(0x6))
    assert heard(one).arbitration_id == 0x6
    assert other.recv(0.05) is None


def test_every_other_node_hears(connect: Connect) -> None:
    nodes = [connect() for _ in range(4)]
    nodes[0].send(message(0x42))
    assert {heard(node).arbitration_id for node in nodes[1:]} == {0x42}


def test_waiting_ends_when_it_should(pair: tuple[can.BusABC, can.BusABC]) -> None:
    one, other = pair
    assert one.recv(0.0) is None
    before = time.monotonic()
    assert one.recv(0.2) is None
    assert time.monotonic() - before >= 0.19
    threading.Timer(0.1, other.send, [message(0x9)]).start()
    assert heard(one).arbitration_id == 0x9


def test_times_are_of_this_moment_and_do_not_run_backwards(
    pair: tuple[can.BusABC, can.BusABC],
) -> None:
    one, other = pair
    before = time.time()
    for _ in range(5):
        one.send(message())
    times = [heard(other).timestamp for _ in range(5)]
    assert times == sorted(times)
    assert before - 0.1 <= times[0] <= time.time() + 0.1


@pytest.mark.parametrize(
    ("filters", "expected"),
    [
        ([{"can_id": 0x100, "can_mask": 0x7FF, "extended": False}], [0x100]),
        ([{"can_id": 0x100, "can_mask": 0x700, "extended": False}], [0x100, 0x1FF]),
        ([{"can_id": 0x100, "can_mask": 0x1FFF_FFFF, "extended": True}], []),
        (
            [
                {"can_id": 0x200, "can_mask": 0x7FF, "extended": False},
                {"can_id": 0x12345, "can_mask": 0x1FFF_FFFF, "extended": True},
            ],
            [0x200, 0x12345],
        ),
        (None, [0x100, 0x1FF, 0x200, 0x12345]),
    ],
)
def test_filters(
    pair: tuple[can.BusABC, can.BusABC],
    filters: list[can.typechecking.CanFilter] | None,
    expected: list[int],
) -> None:
    one, other = pair
    other.set_filters(filters)
    for can_id in (0x100, 0x1FF, 0x200, 0x12345):
        one.send(message(can_id))
    other.set_filters(filters)
    found = [heard(other).arbitration_id for _ in expected]
    assert found == expected
    assert other.recv(0.05) is None


def test_filters_given_at_the_start(connect: Connect) -> None:
    one = connect()
    other = connect(can_filters=[{"can_id": 0x10, "can_mask": 0x7FF, "extended": False}])
    for can_id in (0x11, 0x10):
        one.send(message(can_id))
    assert heard(other).arbitration_id == 0x10


def test_a_notifier_calls_its_listeners(pair: tuple[can.BusABC, can.BusABC]) -> None:
    one, other = pair
    reader = can.BufferedReader()
    notifier = can.Notifier(other, [reader], timeout=0.05)
    try:
        one.send(message(0x77))
        got = reader.get_message(PATIENCE_S)
        assert got is not None
        assert got.arbitration_id == 0x77
    finally:
        notifier.stop()


def test_cyclic_messages(pair: tuple[can.BusABC, can.BusABC]) -> None:
    one, other = pair
    task = one.send_periodic(message(0x33), 0.01)
    assert [heard(other).arbitration_id for _ in range(5)] == [0x33] * 5
    task.stop()
    while other.recv(0.1) is not None:
        pass
    assert other.recv(0.1) is None


def test_two_threads_may_send(pair: tuple[can.BusABC, can.BusABC], connect: Connect) -> None:
    one, other = pair
    third = connect()

    def send(node: can.BusABC, can_id: int) -> None:
        for k in range(100):
            node.send(message(can_id, bytes([k])), timeout=PATIENCE_S)

    threads = [
        threading.Thread(target=send, args=arguments) for arguments in ((one, 0x1), (third, 0x2))
    ]
    for thread in threads:
        thread.start()
    seen: dict[int, list[int]] = {0x1: [], 0x2: []}
    for _ in range(200):
        got = heard(other)
        seen[got.arbitration_id].append(got.data[0])
    for thread in threads:
        thread.join()
    assert seen == {0x1: list(range(100)), 0x2: list(range(100))}


def test_a_bus_that_has_been_shut_down(connect: Connect) -> None:
    with connect() as node:
        node.send(message())
    with pytest.raises((can.CanError, ValueError, OSError)):
        node.send(message())
    node.shutdown()


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setenv("DFTC_BUS_DIR", str(tmp_path / "buses"))
    served = Served(tmp_path / "buses")
    yield served
    served.close()


def wait_for_client(rig: Served, count: int) -> None:
    end = time.monotonic() + PATIENCE_S
    while rig.port.statistics.clients < count:
        assert time.monotonic() < end
        time.sleep(0.01)


def test_can_logger_writes_what_it_hears(rig: Served, tmp_path: Path) -> None:
    log = tmp_path / "bus.log"
    command = [sys.executable, "-m", "can.logger", "-i", "dftc", "-c", "can0", "-f", str(log)]
    # Whoever runs the tests in the background may have had SIGINT ignored.
    heed = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, preexec_fn=heed) as process:
        try:
            wait_for_client(rig, 1)
            with can.Bus(interface="dftc", channel="can0") as node:
                wait_for_client(rig, 2)
                end = time.monotonic() + PATIENCE_S
                while not (log.exists() and "123#0102" in log.read_text()):
                    assert time.monotonic() < end
                    node.send(message())
                    time.sleep(0.05)
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
    with can.LogReader(log) as reader:
        assert {m.arbitration_id for m in reader} == {0x123}


def test_can_viewer_shows_what_it_hears(rig: Served) -> None:
    master, slave = pty.openpty()
    command = [sys.executable, "-m", "can.viewer", "-i", "dftc", "-c", "can0"]
    environment = {**os.environ, "TERM": "xterm", "LINES": "24", "COLUMNS": "80"}
    with subprocess.Popen(
        command, stdin=slave, stdout=slave, stderr=slave, env=environment
    ) as process:
        wait_for_client(rig, 1)
        screen = b""
        with can.Bus(interface="dftc", channel="can0") as node:
            end = time.monotonic() + PATIENCE_S
            while b"0x5A5" not in screen or b"DE AD" not in screen:
                assert time.monotonic() < end, screen
                node.send(message(0x5A5, b"\xde\xad"))
                if select.select([master], [], [], 0.05)[0]:
                    screen += os.read(master, 65536)
        os.write(master, b"\x1b")
        end = time.monotonic() + PATIENCE_S
        while process.poll() is None:
            assert time.monotonic() < end
            if select.select([master], [], [], 0.05)[0]:
                os.read(master, 65536)
        assert process.returncode == 0
    os.close(master)
    os.close(slave)
