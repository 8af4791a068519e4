"""Emulated drives behind a FrameSocket, served inside ``send``: no thread, no wall time."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence

import numpy as np

from dftc_rt.bus.frame import FRAME_SIZE, Frames, frame_buffer, pack, pack_fd, unpack
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.scale import JointScale
from hil.drive.interface import EmulatedDrives
from hil.drive.node402 import Cia402Drives, DriveSpec


class DriveBus:
    """One bus of some emulated drives; a FrameSocket.

    With ``wakes`` it has a descriptor that is readable while frames wait, as a real
    socket has; without, it is the in-process link. Frames of 72 bytes are CAN FD.
    """

    def __init__(
        self, drives: EmulatedDrives, bus: int = 0, wakes: bool = False, size: int = FRAME_SIZE
    ) -> None:
        self.drives = drives
        self.bus = bus
        self.name = f"can{bus}"
        self.fd = os.eventfd(0, os.EFD_NONBLOCK) if wakes else -1
        self.deaf = False
        self.sent: list[tuple[int, bytes]] = []
        self._waiting: list[bytes] = []
        self._out = frame_buffer(64, size)

    def send(self, frames: Frames, count: int) -> int:
        self.sent += [unpack(frames[row]) for row in range(count)]
        row = 0
        while row < count and not self.deaf:
            row = self.drives.receive(self.bus, frames, row, count)
            self.collect()
        return count

    def collect(self) -> None:
        """Take what the drives have to say."""
        count = self.drives.answer(self.bus, self._out)
        self._waiting += [bytes(self._out[row]) for row in range(count)]
        if count and self.fd >= 0:
            os.eventfd_write(self.fd, 1)

    def receive(self, frames: Frames) -> int:
        count = min(len(self._waiting), len(frames))
        for row in range(count):
            frames[row] = np.frombuffer(self._waiting[row], dtype=np.uint8)
        del self._waiting[:count]
        if self.fd >= 0 and not self._waiting:
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(self.fd)
        return count

    def close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    # --- for tests -----------------------------------------------------------------

    def exchange(self, *frames: tuple[int, bytes]) -> list[tuple[int, bytes]]:
        """Send some frames in one batch; return what came back."""
        size = self._out.shape[1]
        make = pack if size == FRAME_SIZE else pack_fd
        batch = frame_buffer(max(len(frames), 1), size)
        for row, (can_id, data) in enumerate(frames):
            batch[row] = np.frombuffer(make(can_id, data), dtype=np.uint8)
        self.send(batch, len(frames))
        self.collect()
        return self.take()

    def take(self) -> list[tuple[int, bytes]]:
        """Return what waits."""
        answers = [unpack(np.frombuffer(raw, dtype=np.uint8)) for raw in self._waiting]
        self._waiting.clear()
        return answers


def scales(n: int, **changes: float) -> list[JointScale]:
    """Return n data sheets: 1000 counts/rev, gear 100, 50 Nm rated, 100 Nm at most."""
    sheet = {"counts_per_rev": 1000, "rated_torque_nm": 50.0, "max_torque_nm": 100.0, "gear": 100.0}
    return [JointScale(joint=f"joint{i + 1}", **(sheet | changes)) for i in range(n)]  # type: ignore[arg-type]


def drives_of(sheets: Sequence[JointScale], per_bus: int = 3, **spec: float) -> Cia402Drives:
    """Return emulated drives with node ids 1, 2, … spread over buses, boot-up taken."""
    specs = [DriveSpec(i + 1, i // per_bus, sheet, **spec) for i, sheet in enumerate(sheets)]
    drives = Cia402Drives(specs, buses=(len(specs) - 1) // per_bus + 1)
    out = frame_buffer(64)
    for bus in range((len(specs) - 1) // per_bus + 1):
        drives.answer(bus, out)
    return drives


def configs(sheets: Sequence[JointScale], per_bus: int = 3) -> list[DriveConfig]:
    """Return what the robot file says about the same drives."""
    return [DriveConfig(i + 1, i // per_bus, sheet) for i, sheet in enumerate(sheets)]


# SDO, written out by hand (CiA 301, "SDO download/upload initiate", expedited).


def sdo_write(index: int, subindex: int, value: int, size: int) -> bytes:
    """Return an expedited download request: 23h, 27h, 2Bh, 2Fh for 4, 3, 2, 1 bytes."""
    command = 0x23 | (4 - size) << 2
    data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
    return bytes([command, index & 0xFF, index >> 8, subindex]) + data


def sdo_read(index: int, subindex: int) -> bytes:
    """Return an upload request: 40h."""
    return bytes([0x40, index & 0xFF, index >> 8, subindex, 0, 0, 0, 0])


def write(bus: DriveBus, node: int, index: int, subindex: int, value: int, size: int) -> int:
    """Write an object; return 0, or the abort code."""
    for can_id, data in bus.exchange((0x600 + node, sdo_write(index, subindex, value, size))):
        if can_id == 0x580 + node:
            return int.from_bytes(data[4:], "little") if data[0] == 0x80 else 0
    raise AssertionError("no SDO response")


def read(bus: DriveBus, node: int, index: int, subindex: int = 0) -> int:
    """Read an object as an unsigned number.

    Raises:
        LookupError: The drive aborted, with that code.
    """
    for can_id, data in bus.exchange((0x600 + node, sdo_read(index, subindex))):
        if can_id == 0x580 + node:
            if data[0] == 0x80:
                raise LookupError(int.from_bytes(data[4:], "little"))
            size = 4 - (data[0] >> 2 & 3)
            return int.from_bytes(data[4 : 4 + size], "little")
    raise AssertionError("no SDO response")
