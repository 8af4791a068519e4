"""CAN FD both ways through python-can: its tools on our bus, its interfaces as our sockets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from dftc_rt.bus.directory import BusDirectory
from dftc_rt.bus.frame import (
    BRS,
    EFF_FLAG,
    ESI,
    FD_FRAME_SIZE,
    FDF,
    Frames,
    frame_buffer,
    pack,
    pack_fd,
)
from dftc_rt.bus.python_can import DftcBus
from dftc_rt.bus.python_can_socket import open_python_can
from hil.bus.unix import UnixPort, listen

# As rows of our batches, and as python-can has them: FD with and without the other bit rate, a
# sender that is error passive, and a classical frame.
ROWS = [
    pack_fd(EFF_FLAG | 0x8001, bytes(range(24)), BRS),
    pack_fd(0x100, bytes(range(16)), 0),
    pack_fd(0x101, b"\x01", BRS | ESI),
    pack(0x181, bytes(range(8))),
]
MESSAGES = [
    can.Message(arbitration_id=0x8001, is_fd=True, bitrate_switch=True, data=bytes(range(24))),
    can.Message(arbitration_id=0x100, is_extended_id=False, is_fd=True, data=bytes(range(16))),
    can.Message(
        arbitration_id=0x101, is_extended_id=False, is_fd=True, bitrate_switch=True,
        error_state_indicator=True, data=b"\x01",
    ),
    can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(range(8))),
]  # fmt: skip


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[UnixPort]:
    monkeypatch.setenv("DFTC_BUS_DIR", str(tmp_path / "buses"))
    claim = BusDirectory(tmp_path / "buses")
    port = UnixPort("can0", listen(claim.path, "can0"), data_bitrate=5_000_000)
    yield port
    port.close()
    claim.release()


def batch() -> Frames:
    frames = frame_buffer(len(ROWS), FD_FRAME_SIZE)
    for row, raw in zip(frames, ROWS, strict=True):
        row[: len(raw)] = np.frombuffer(raw, dtype=np.uint8)
    return frames


def same(message: can.Message | None, expected: can.Message) -> bool:
    return message is not None and message.equals(
        expected, timestamp_delta=None, check_channel=False, check_direction=False
    )


def test_a_tool_sends_and_hears_fd_and_classical_frames(rig: UnixPort) -> None:
    with can.Bus(interface="dftc", channel="can0", fd=True) as tool:
        assert isinstance(tool, DftcBus)
        frames = frame_buffer(8, FD_FRAME_SIZE)
        rig.receive(frames)
        for message, raw in zip(MESSAGES, ROWS, strict=True):
            tool.send(message)
            assert rig.receive(frames) == 1
            assert bytes(frames[0]).startswith(raw)
        for row, message in enumerate(MESSAGES):  # one by one: a batch would be sorted
            rig.send(batch()[row : row + 1].copy(), 1)
            assert same(tool.recv(timeout=60.0), message)


def test_a_classical_tool_hears_the_classical_ones_alone(rig: UnixPort) -> None:
    with DftcBus("can0") as tool:
        rig.receive(frame_buffer(4, FD_FRAME_SIZE))
        rig.send(batch(), len(ROWS))
        message = tool.recv(timeout=60.0)
        while message is None:  # what it leaves out wakes it, too
            message = tool.recv(timeout=60.0)
        assert same(message, MESSAGES[3])
        with pytest.raises(can.CanOperationError, match="classical frames only"):
            tool.send(MESSAGES[0])


def test_an_interface_is_a_socket_for_fd_frames() -> None:
    node = open_python_can("can0", "virtual", "fd-bus-of-this-test", 1_000_000, 5_000_000)
    with can.Bus(interface="virtual", channel="fd-bus-of-this-test") as other:
        assert node.send(batch(), len(ROWS)) == len(ROWS)
        for message in MESSAGES:
            assert same(other.recv(timeout=60.0), message)
        frames = frame_buffer(len(ROWS), FD_FRAME_SIZE)
        for message in MESSAGES:
            other.send(message)
        count = 0
        while count < len(ROWS):
            count += node.receive(frames[count:])
        for row, raw in enumerate(ROWS):
            assert bytes(frames[row]).startswith(raw)
            assert bool(frames[row, 5] & FDF) == (len(raw) == FD_FRAME_SIZE)
    node.close()


def test_bit_rates_reach_the_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, object]] = []

    def opened(**options: object) -> can.BusABC:
        asked.append(options)
        raise can.CanInitializationError("no adapter here")

    monkeypatch.setattr(can, "Bus", opened)
    for data_bitrate in (None, 5_000_000):
        with pytest.raises(Exception, match="no adapter here"):
            open_python_can("can0", "pcan", "PCAN_USBBUS1", 1_000_000, data_bitrate)
    common = {"channel": "PCAN_USBBUS1", "interface": "pcan", "bitrate": 1_000_000}
    assert asked == [common, common | {"fd": True, "data_bitrate": 5_000_000}]
