"""The transports that pass the bus conformance suite: each opens a bus and joins nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dftc_rt.bus.directory import BusDirectory
from dftc_rt.bus.frame import Frames, frame_buffer, pack, unpack
from dftc_rt.bus.interface import FilteringSocket, FrameSocket
from dftc_rt.bus.socketcan import SocketCanSocket
from dftc_rt.bus.unix import connect
from dftc_rt.bus.wait import Waiter
from hil.bus.inprocess import InProcessPort
from hil.bus.port import BusPort
from hil.bus.socketcan import SocketCanPort
from hil.bus.unix import UnixPort, listen
from hil.bus.virtual_bus import Timing

Opener = Callable[[Path, Timing], "Transport"]

DATA_BITRATE = 5_000_000
PATIENCE_S = 5.0  # how long a frame may take before the test fails


@dataclass
class Transport:
    """One open bus under test.

    Attributes:
        port: The rig's end.
        connect: Makes one more node.
        close_actions: What undoes the set-up.
    """

    port: BusPort
    connect: Callable[[], FilteringSocket]
    close_actions: list[Callable[[], None]] = field(default_factory=list)

    def join(self) -> FilteringSocket:
        """Return one more node, closed with the bus."""
        node = self.connect()
        self.close_actions.insert(0, node.close)
        return node

    def close(self) -> None:
        """Close everything."""
        self.port.close()
        for action in self.close_actions:
            action()


def open_inprocess(directory: Path, timing: Timing = "account") -> Transport:
    """Open an in-process bus."""
    port = InProcessPort("can0", timing=timing)
    return Transport(port, port.connect)


def open_unix(directory: Path, timing: Timing = "account") -> Transport:
    """Open a bus on AF_UNIX in ``directory``."""
    claim = BusDirectory(directory / "buses")
    port = UnixPort("can0", listen(claim.path, "can0"), timing=timing)
    return Transport(port, lambda: connect("can0", claim.path), close_actions=[claim.release])


def open_vcan(directory: Path, timing: Timing = "account") -> Transport:
    """Open a bus on the interface vcan0."""
    port = SocketCanPort("can0", "vcan0", timing=timing)
    return Transport(port, lambda: SocketCanSocket("can0", "vcan0"))


def fd_inprocess(directory: Path, timing: Timing = "account") -> Transport:
    """Open an in-process bus that carries FD frames."""
    port = InProcessPort("can0", timing=timing, data_bitrate=DATA_BITRATE)
    return Transport(port, port.connect)


def fd_unix(directory: Path, timing: Timing = "account") -> Transport:
    """Open such a bus on AF_UNIX in ``directory``."""
    claim = BusDirectory(directory / "buses")
    listener = listen(claim.path, "can0")
    port = UnixPort("can0", listener, timing=timing, data_bitrate=DATA_BITRATE)
    return Transport(port, lambda: connect("can0", claim.path), close_actions=[claim.release])


def fd_vcan(directory: Path, timing: Timing = "account") -> Transport:
    """Open such a bus on the interface vcan0, whose mtu is 72."""
    port = SocketCanPort("can0", "vcan0", timing=timing, data_bitrate=DATA_BITRATE)
    return Transport(port, lambda: SocketCanSocket("can0", "vcan0", fd=True))


def batch(frames: list[tuple[int, bytes]]) -> Frames:
    """Return (identifier, data) pairs as a batch without spare rows."""
    rows = frame_buffer(len(frames))
    for row, (can_id, data) in zip(rows, frames, strict=True):
        row[:] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    return rows


def contents(frames: Frames, count: int) -> list[tuple[int, bytes]]:
    """Return the first ``count`` rows as (identifier, data) pairs."""
    return [unpack(frames[row]) for row in range(count)]


def collect(port: BusPort, count: int) -> list[tuple[int, bytes]]:
    """Receive at the port until ``count`` frames are there; fail rather than hang."""
    return _collect(port.receive, port.fds, count)


def collect_node(node: FrameSocket, count: int) -> list[tuple[int, bytes]]:
    """Receive at a node until ``count`` frames are there; fail rather than hang."""
    return _collect(node.receive, lambda: [node.fd] if node.fd >= 0 else [], count)


def _collect(
    receive: Callable[[Frames], int], fds: Callable[[], list[int]], count: int
) -> list[tuple[int, bytes]]:
    buffer = frame_buffer(64)
    got: list[tuple[int, bytes]] = []
    while True:
        got += contents(buffer, fresh := receive(buffer))
        if len(got) >= count:
            return got
        if not fresh and not (fds() and Waiter(fds()).wait(PATIENCE_S)):
            raise AssertionError(f"{len(got)} of {count} frames came")


def numbered(count: int, can_id: int = 0x123) -> list[tuple[int, bytes]]:
    """Return frames that can be told apart."""
    return [(can_id, number.to_bytes(8, "little")) for number in range(count)]


def receive_until_barrier(bus: Transport) -> None:
    """Receive nothing but a barrier."""
    buffer = frame_buffer(4)
    while True:
        assert bus.port.receive(buffer) == 0
        if bus.port.barrier_pending:
            return
        fds = bus.port.fds()
        assert fds
        assert Waiter(fds).wait(PATIENCE_S)
