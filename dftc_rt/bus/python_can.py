"""The user-space bus for every python-can tool: ``can.Bus(interface="dftc", channel="can0")``.

python-can finds this class through the entry point group ``can.interface``.
"""

from __future__ import annotations

import os
import stat
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import can
import numpy as np

from dftc_rt.bus.directory import check_directory, resolve_directory
from dftc_rt.bus.filters import MOST_FILTERS
from dftc_rt.bus.frame import (
    BRS,
    EFF_FLAG,
    EFF_MASK,
    ERR_FLAG,
    ESI,
    FD_FRAME_SIZE,
    FDF,
    FRAME_SIZE,
    RTR_FLAG,
    SFF_MASK,
    Frames,
    frame_buffer,
)
from dftc_rt.bus.unix import UnixSocket, connect
from dftc_rt.bus.wait import Waiter
from dftc_rt.errors import BusError, DftcError

_ROOM_RETRY_S = 1e-3


def to_frame(message: can.Message, frames: Frames, row: int) -> None:
    """Write a python-can message into a row of a batch.

    Raises:
        can.CanOperationError: It is an error frame, or an FD frame and the batch is classical.
    """
    if message.is_error_frame or (message.is_fd and frames.shape[1] != FD_FRAME_SIZE):
        what = "data and remote frames" if message.is_error_frame else "classical frames"
        raise can.CanOperationError(f"this bus carries {what} only")
    can_id = message.arbitration_id
    can_id |= EFF_FLAG if message.is_extended_id else 0
    can_id |= RTR_FLAG if message.is_remote_frame else 0
    frames[row] = 0
    frames[row, :4] = np.frombuffer(can_id.to_bytes(4, "little"), dtype=np.uint8)
    frames[row, 4] = message.dlc
    if message.is_fd:
        brs = BRS if message.bitrate_switch else 0
        frames[row, 5] = FDF | brs | (ESI if message.error_state_indicator else 0)
    frames[row, 8 : 8 + len(message.data)] = message.data


def to_message(frames: Frames, row: int, channel: str | int, timestamp: float) -> can.Message:
    """Return a row of a batch as a python-can message.

    Args:
        frames: Batch, uint8, shape ``(capacity, 16)``, or ``(capacity, 72)`` for FD.
        row: Row to convert.
        channel: Logical bus name.
        timestamp: Time of reception, s since the epoch.
    """
    raw = frames[row].tobytes()
    can_id = int.from_bytes(raw[:4], "little")
    remote = bool(can_id & RTR_FLAG)
    flags = raw[5] if len(raw) == FD_FRAME_SIZE else 0
    fd = bool(flags & FDF)
    return can.Message(
        timestamp=timestamp,
        arbitration_id=can_id & EFF_MASK,
        is_extended_id=bool(can_id & EFF_FLAG),
        is_remote_frame=remote,
        is_error_frame=bool(can_id & ERR_FLAG),
        dlc=raw[4],
        data=b"" if remote else raw[8 : 8 + raw[4]],
        channel=channel,
        is_fd=fd,
        bitrate_switch=fd and bool(flags & BRS),
        error_state_indicator=fd and bool(flags & ESI),
        is_rx=True,
    )


def to_filters(
    filters: Sequence[can.typechecking.CanFilter] | None,
) -> list[tuple[int, int]] | None:
    """Return python-can's filters as the bus has them; None where it has to forward everything."""
    if not filters or len(filters) > MOST_FILTERS:
        return None
    found = []
    for each in filters:
        identifier, mask = each["can_id"], each["can_mask"]
        extended = each.get("extended")
        if extended is None:
            found.append((identifier & mask & EFF_MASK, mask & EFF_MASK))
        elif extended:
            found.append((identifier & EFF_MASK | EFF_FLAG, mask & EFF_MASK | EFF_FLAG))
        elif not identifier & mask & ~SFF_MASK:  # else nothing with 11 bits matches
            found.append((identifier & SFF_MASK, mask & SFF_MASK | EFF_FLAG))
    return found


class DftcBus(can.BusABC):
    """A node on the user-space bus.

    The rig forwards what this node sends and counts what it is too slow to read.
    """

    def __init__(
        self,
        channel: str = "can0",
        can_filters: Sequence[can.typechecking.CanFilter] | None = None,
        bus_dir: str | os.PathLike[str] | None = None,
        receive_own_messages: bool = False,
        fd: bool = False,
        **kwargs: Any,
    ) -> None:
        """Join a bus that a rig has open.

        Args:
            channel: Logical bus name.
            can_filters: As for every python-can bus; the bus forwards nothing else.
            bus_dir: Directory of the buses; by default found as the commands find it.
            receive_own_messages: Also receive what this node sends, once it is sent.
            fd: Take part in CAN FD, besides classical frames; the rig's bus must carry it.
            **kwargs: Passed on to ``can.BusABC``.

        Raises:
            can.CanInitializationError: There is no such bus, or its directory is unsafe.
        """
        try:
            directory = resolve_directory(bus_dir)
            check_directory(directory)
            self._node: UnixSocket = connect(channel, directory)
        except DftcError as error:
            raise can.CanInitializationError(str(error)) from error
        self.channel = channel
        self.channel_info = f"dftc {channel} in {directory}"
        size = FD_FRAME_SIZE if fd else FRAME_SIZE
        self._tx = frame_buffer(1, size)
        self._sending = threading.Lock()  # periodic messages come from a thread of their own
        self._rx = frame_buffer(1, size)
        self._waiter = Waiter([self._node.fd])
        self._forwarded: list[tuple[int, int]] | None = None  # what the bus was told; None: all
        self._own: deque[can.Message] | None = deque() if receive_own_messages else None
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one message; from any thread.

        Args:
            msg: Data or remote frame; FD frames on a bus opened with ``fd``.
            timeout: Seconds to wait for room in the socket; None does not wait.

        Raises:
            can.CanTimeoutError: There was no room.
            can.CanOperationError: The bus has gone away, or the message does not fit it.
        """
        with self._sending:
            to_frame(msg, self._tx, 0)
            deadline = time.monotonic() + (timeout or 0.0)
            try:
                while not self._node.send(self._tx, 1):
                    if time.monotonic() >= deadline:
                        raise can.CanTimeoutError("the rig does not read its bus")
                    time.sleep(_ROOM_RETRY_S)
            except BusError as error:
                raise can.CanOperationError(str(error)) from error
            if self._own is not None:
                own = to_message(self._tx, 0, self.channel, time.time())
                own.is_rx = False
                self._own.append(own)

    def _apply_filters(self, filters: can.typechecking.CanFilters | None) -> None:
        """Have the bus keep the filters; what it had sent before is matched here, as ever.

        Raises:
            can.CanOperationError: The bus has gone away, or does not read.
        """
        chosen = to_filters(filters)
        if chosen == self._forwarded:
            return
        with self._sending:
            try:
                self._node.set_filters(chosen)
            except BusError as error:
                raise can.CanOperationError(str(error)) from error
        self._forwarded = chosen

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._own:
            return self._own.popleft(), False
        try:
            if not self._node.receive(self._rx):
                if timeout == 0.0:
                    return None, False
                self._waiter.wait(3600.0 if timeout is None else timeout)
                if not self._node.receive(self._rx):
                    return None, False
        except BusError as error:
            raise can.CanOperationError(str(error)) from error
        return to_message(self._rx, 0, self.channel, time.time()), False

    def fileno(self) -> int:
        """Return the descriptor that becomes readable when a frame waits."""
        return self._node.fd

    def shutdown(self) -> None:
        """Leave the bus."""
        super().shutdown()
        self._node.close()

    @staticmethod
    def _detect_available_configs() -> list[can.typechecking.AutoDetectedConfig]:
        directory = resolve_directory()
        try:
            check_directory(directory)
        except DftcError:
            return []
        return [
            {"interface": "dftc", "channel": entry.name}
            for entry in sorted(directory.iterdir())
            if stat.S_ISSOCK(entry.lstat().st_mode)
        ]
