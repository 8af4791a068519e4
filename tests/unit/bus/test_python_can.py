"""Both ways through python-can: its tools on our bus, and its interfaces as our sockets.

The other end is an independent implementation each time: python-can's own virtual bus.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from can.interfaces.virtual import VirtualBus

from dftc_rt.bus.directory import BusDirectory
from dftc_rt.bus.error_frames import BUS_ERROR
from dftc_rt.bus.frame import EFF_FLAG, ERR_FLAG, RTR_FLAG, Frames, frame_buffer
from dftc_rt.bus.python_can import DftcBus, to_filters
from dftc_rt.bus.python_can_socket import PythonCanSocket, open_python_can
from dftc_rt.bus.unix import UnixSocket, connect
from dftc_rt.bus.wait import wait
from dftc_rt.errors import BusError, EnvironmentLacksError
from hil.bus.unix import UnixPort, listen
from tests.conformance.bus_transports import batch, collect, collect_node, contents

pytestmark = pytest.mark.realtime

SENT = [(0x181, bytes(range(8))), (EFF_FLAG | 0x18FF_1234, b"\x01"), (RTR_FLAG | 0x701, b"")]
MESSAGES = [
    can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(range(8))),
    can.Message(arbitration_id=0x18FF_1234, is_extended_id=True, data=b"\x01"),
    can.Message(arbitration_id=0x701, is_extended_id=False, is_remote_frame=True, dlc=0),
]


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[UnixPort]:
    monkeypatch.setenv("DFTC_BUS_DIR", str(tmp_path / "buses"))
    claim = BusDirectory(tmp_path / "buses")
    port = UnixPort("can0", listen(claim.path, "can0"))
    yield port
    port.close()
    claim.release()


def same(message: can.Message | None, expected: can.Message) -> bool:
    return message is not None and message.equals(
        expected, timestamp_delta=None, check_channel=False, check_direction=False
    )


def test_a_python_can_tool_is_a_node_like_any_other(rig: UnixPort, tmp_path: Path) -> None:
    node = connect("can0", tmp_path / "buses")
    with can.Bus(interface="dftc", channel="can0") as tool:
        assert isinstance(tool, DftcBus)
        rig.receive(frame_buffer(4))
        for message in MESSAGES:
            tool.send(message)
        assert collect(rig, 3) == SENT
        assert collect_node(node, 3) == SENT
        node.send(batch(SENT), 3)
        collect(rig, 3)
        for message in MESSAGES:
            assert same(tool.recv(timeout=60.0), message)
        assert tool.recv(timeout=0.0) is None
        assert tool.recv(timeout=1e-4) is None
    node.close()


def test_filters_and_detection(rig: UnixPort) -> None:
    assert DftcBus._detect_available_configs() == [{"interface": "dftc", "channel": "can0"}]
    only = [can.typechecking.CanFilter(can_id=0x182, can_mask=0x7FF, extended=False)]
    with DftcBus("can0", can_filters=only) as tool:
        rig.receive(frame_buffer(4))
        rig.send(batch([(0x181, b"a"), (0x182, b"b")]), 2)
        message = tool.recv(timeout=60.0)
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x182, b"b")
        rig.send(batch([(0x181, b"a"), (0x183, b"c")]), 2)
        assert tool._node.receive(frame_buffer(4)) == 0  # the bus has forwarded neither
        tool.set_filters(None)
        rig.receive(frame_buffer(4))
        rig.send(batch([(0x181, b"a"), (0x183, b"c")]), 2)
        assert tool._node.receive(frame_buffer(4)) == 2


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (None, None),
        ([], None),
        ([(0x100, 0x7FF, None)], [(0x100, 0x7FF)]),
        ([(0x100, 0x7FF, False)], [(0x100, 0x7FF | EFF_FLAG)]),
        ([(0x100, 0x1FFF_FFFF, True)], [(0x100 | EFF_FLAG, 0x1FFF_FFFF | EFF_FLAG)]),
        ([(0x12345, 0x1FFF_FFFF, False)], []),  # no identifier of 11 bits is that
        ([(0x100, 0x7FF, None)] * 513, None),  # more than the bus keeps: all matched in python-can
    ],
)
def test_python_can_s_filters_are_the_bus_s(
    given: list[tuple[int, int, bool | None]] | None, expected: list[tuple[int, int]] | None
) -> None:
    filters = (
        None
        if given is None
        else [
            {"can_id": can_id, "can_mask": mask}
            | ({} if extended is None else {"extended": extended})
            for can_id, mask, extended in given
        ]
    )
    assert to_filters(filters) == expected  # type: ignore[arg-type]


def test_what_the_bus_does_not_carry_is_refused(rig: UnixPort) -> None:
    with DftcBus("can0") as tool, pytest.raises(can.CanOperationError, match="classical"):
        tool.send(can.Message(is_fd=True, data=bytes(12)))


def test_no_bus_and_a_bus_that_goes_away(rig: UnixPort) -> None:
    with pytest.raises(can.CanInitializationError, match="can5"):
        DftcBus("can5")
    with DftcBus("can0") as tool:
        rig.receive(frame_buffer(4))
        rig.close()
        with pytest.raises(can.CanOperationError, match="gone away"):
            tool.recv(timeout=60.0)
        with pytest.raises(can.CanOperationError, match="gone away"):
            tool.send(MESSAGES[0])


def test_threads_do_not_send_each_others_frames(
    rig: UnixPort, monkeypatch: pytest.MonkeyPatch
) -> None:
    # python-can's periodic messages, a master's SYNC, come from a thread of their own.
    with can.Bus(interface="dftc", channel="can0") as tool:
        assert isinstance(tool, DftcBus)
        rig.receive(frame_buffer(4))
        send = UnixSocket.send
        other = threading.Thread(target=tool.send, args=(MESSAGES[1],))

        def interrupted(node: UnixSocket, frames: Frames, count: int) -> int:
            if other.ident is None:
                other.start()
                other.join(0.1)  # it is to wait: were it let in, it would be done by then
            return send(node, frames, count)

        monkeypatch.setattr(UnixSocket, "send", interrupted)
        tool.send(MESSAGES[0])
        other.join()
        assert collect(rig, 2) == SENT[:2]


def test_a_rig_that_does_not_read_times_the_sender_out(rig: UnixPort) -> None:
    def send_until_full(tool: can.BusABC) -> None:
        while True:
            tool.send(MESSAGES[0])

    with DftcBus("can0") as tool, pytest.raises(can.CanTimeoutError):
        send_until_full(tool)


def test_a_python_can_interface_is_a_socket(tmp_path: Path) -> None:
    node = open_python_can("can0", "virtual", "bus-of-this-test", 1_000_000)
    with can.Bus(interface="virtual", channel="bus-of-this-test") as other:
        assert node.send(batch(SENT), 3) == 3
        for message in MESSAGES:
            assert same(other.recv(timeout=60.0), message)
        assert not wait([node], 0.0)
        for message in MESSAGES:
            other.send(message)
        frames = frame_buffer(2)
        assert received(node, frames, 3) == SENT
        assert node.receive(frames) == 0
        assert not wait([node], 0.0)
        other.send(can.Message(is_error_frame=True))
        other.send(can.Message(arbitration_id=0x5, is_fd=True))
        other.send(MESSAGES[0])
        assert received(node, frames, 2) == [(ERR_FLAG | BUS_ERROR, bytes(8)), SENT[0]]
    node.close()
    node.close()
    with pytest.raises(BusError):
        node.send(batch(SENT), 3)
    with pytest.raises(BusError):
        node.receive(frames)


def received(node: PythonCanSocket, frames: Frames, expected: int) -> list[tuple[int, bytes]]:
    """Frames as they come: the virtual interface has no descriptor, a thread reads it."""
    found: list[tuple[int, bytes]] = []
    while len(found) < expected:
        assert wait([node], 10.0)
        count = node.receive(frames)
        found += contents(frames, count)
    return found


def test_a_reader_passes_on_that_the_bus_has_gone() -> None:
    class Unplugged(VirtualBus):
        def recv(self, timeout: float | None = None) -> can.Message | None:
            raise can.CanOperationError("unplugged")

    node = PythonCanSocket("can0", Unplugged("bus-that-goes"))
    assert wait([node], 10.0)
    with pytest.raises(BusError, match="unplugged"):
        node.receive(frame_buffer(2))
    node.close()


def test_an_interface_that_python_can_does_not_know() -> None:
    with pytest.raises(EnvironmentLacksError, match="teleport"):
        open_python_can("can0", "teleport", "0", 1_000_000)


def test_a_descriptor_is_passed_on_where_there_is_one(rig: UnixPort) -> None:
    with DftcBus("can0") as tool:
        assert PythonCanSocket("can0", tool).fd == tool.fileno() >= 0
