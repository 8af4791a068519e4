"""Set-up of moteus drives: find each one, stop it, and where it is.

A drive is configured with mjbots' own tools; nothing of that is written here. Set-up stops each
drive, which clears a fault whose cause is gone, and reads mode, position and fault code.

Everything here happens before the loop starts and after it has ended, in the caller's
thread; it may raise, wait and allocate. On success it depends on no clock.

Source: [moteus].
"""

from __future__ import annotations

import math
import select
import time
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from dftc_rt.bus.frame import EFF_FLAG, EFF_MASK, ERR_FLAG, FD_FRAME_SIZE, frame_buffer, unpack
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import DriveConfig, SetUp
from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus.cycle import COUNTS_PER_REV
from dftc_rt.drives.moteus.scale import scales_of
from dftc_rt.errors import BusError, DriveError, InputError

_SHUTDOWN_TIMEOUT_S: Final = 0.1  # a drive that is there answers at once
_BATCH: Final = 64
_TIMES: Final = 2
"""How often a drive is told at a time. One frame may be lost; and a rig in lock-step, which keeps
an answer until the controller ends its cycle, sees by the second one that no cycle is going on."""
_AT_STOP_RAD: Final = 1e-3  # by which a joint at its limit may seem to be beyond it
_TRIES: Final = 5  # a drive may answer before it has changed its mode


class MoteusClient:
    """The controller's side of all moteus drives of a robot, outside of the loop."""

    def __init__(
        self,
        sockets: Sequence[FrameSocket],
        drives: Sequence[DriveConfig],
        rate_hz: float,
        timeout_s: float = 1.0,
    ) -> None:
        """Attach to the buses; nothing is sent yet.

        Args:
            sockets: One per bus, for FD frames.
            drives: The drives, in joint order, with ``MoteusScale``.
            rate_hz: Cycles per second; a drive is not told it.
            timeout_s: Longest wait for one answer, s.

        Raises:
            InputError: Two drives of a bus share a node id, or one is of another profile.
        """
        self._sockets = list(sockets)
        self._drives = tuple(drives)
        self._scales = scales_of(drives)
        self._timeout_s = timeout_s
        self._out = frame_buffer(_TIMES, FD_FRAME_SIZE)
        self._in = frame_buffer(_BATCH, FD_FRAME_SIZE)
        self._found = np.zeros(5)
        taken: set[tuple[int, int]] = set()
        for drive in drives:
            if (drive.bus, drive.node_id) in taken:
                where = self._sockets[drive.bus].name
                raise InputError(drive.scale.joint, f"node id {drive.node_id} is taken on {where}")
            taken.add((drive.bus, drive.node_id))

    def configure(self) -> SetUp:
        """Stop every drive, and find out where it is.

        Raises:
            DriveError: A drive is missing, does not stop, is in fault, or is where its joint
                cannot be.
            BusError: A bus has gone away.
        """
        n = len(self._drives)
        at_rest = int(states.STATE_BITS[states.SWITCHED_ON])
        found = SetUp(np.full(n, at_rest, dtype=np.int64), np.zeros(n, dtype=np.int64))
        for i in range(n):
            self._stop(i)
            mode, position, _, _, fault = self._found.tolist()
            if mode == reg.FAULTED:
                raise self._error(i, f"in fault, code {fault:.0f}")
            if mode != reg.STOPPED:
                raise self._error(i, f"does not stop: mode {mode:.0f}")
            found.counts[i] = round(position * COUNTS_PER_REV)
            self._check_position(i, position)
        for socket in self._sockets:
            self._drain(socket)
        return found

    def examine(self) -> tuple[str, ...]:
        """Read the state of every drive; no register is written.

        Returns:
            What is wrong with each drive, "" with one that answers as it should.

        Raises:
            BusError: A bus has gone away.
        """
        found: list[str] = []
        for i in range(len(self._drives)):
            try:
                self._ask(i, codec.encode_query)
                mode, position, _, _, fault = self._found.tolist()
                if mode == reg.FAULTED:
                    raise self._error(i, f"in fault, code {fault:.0f}")
                self._check_position(i, position)
                found.append("")
            except DriveError as error:
                found.append(error.what)
        return tuple(found)

    def shutdown(self) -> tuple[str, ...]:
        """Stop every drive, best effort.

        Returns:
            Joints whose drive did not confirm.
        """
        silent = []
        self._timeout_s = min(self._timeout_s, _SHUTDOWN_TIMEOUT_S)
        for i, drive in enumerate(self._drives):
            try:
                self._stop(i)
            except (DriveError, BusError):
                silent.append(drive.scale.joint)
                continue
            if self._found[0] not in (reg.STOPPED, reg.FAULTED):
                silent.append(drive.scale.joint)
        return tuple(silent)

    def _stop(self, i: int) -> None:
        """Tell a drive to stop until its answer says so; the last answer is in ``_found``.

        Raises:
            DriveError: It did not answer; says who did.
            BusError: The bus has gone away, or takes no frame.
        """
        for _ in range(_TRIES):
            self._ask(i)
            if self._found[0] == reg.STOPPED:
                return

    def _ask(self, i: int, encode: Callable[..., int] = codec.encode_stop) -> None:
        """Tell a drive to stop, or what ``encode`` writes, and read its first answer.

        Raises:
            DriveError: It did not answer; says who did.
            BusError: The bus has gone away, or takes no frame.
        """
        drive, socket = self._drives[i], self._sockets[self._drives[i].bus]
        host = self._scales[i].host_id
        self._drain(socket)  # what a loop before has left is no answer to this
        for row in range(_TIMES):
            encode(self._out, row, drive.node_id, host)
        deadline = time.monotonic() + self._timeout_s
        sent = socket.send(self._out, _TIMES)
        while sent < _TIMES:
            if not self._wait(socket, deadline, select.POLLOUT):
                raise BusError(socket.name, "takes no frames (is another node on the bus?)")
            sent += socket.send(self._out, _TIMES - sent)
        heard: list[str] = []
        while True:
            count = socket.receive(self._in)
            for row in range(count):
                can_id, data = unpack(self._in[row])
                if can_id & ERR_FLAG:
                    continue
                if can_id & ~EFF_FLAG != drive.node_id << 8 | host:
                    heard.append(f"identifier 0x{can_id & EFF_MASK:X}")
                elif not codec.decode_answer(self._in[row, 8:], len(data), self._found):
                    heard.append("an answer without position and velocity")
                elif math.isnan(self._found[0]):
                    heard.append("an answer without mode")
                else:
                    return
            if not count and not self._wait(socket, deadline, select.POLLIN):
                who = f"; heard {', '.join(dict.fromkeys(heard))}" if heard else ""
                word = "stop" if encode is codec.encode_stop else "query"
                raise self._error(i, f"no answer to '{word}' within {self._timeout_s:g} s{who}")

    def _drain(self, socket: FrameSocket) -> None:
        """Receive what waits, and forget it."""
        while socket.receive(self._in):
            pass

    def _wait(self, socket: FrameSocket, deadline: float, what: int) -> bool:
        """Wait until a socket is ready, briefly; return whether to go on.

        On the in-process link the other side has run when ``send`` returned, so what has
        not come by now will not come, and there is no waiting.
        """
        left = deadline - time.monotonic()
        if socket.fd < 0 or left <= 0:
            return False
        poll = select.poll()
        poll.register(socket.fd, what)
        poll.poll(min(1000.0 * left, 10.0))
        return True

    def _check_position(self, i: int, position: float) -> None:
        """Refuse a position where the joint cannot be: the drive's zero is elsewhere."""
        scale = self._scales[i]
        q = scale.sign * math.tau * position - scale.zero_offset_rad
        if not scale.lower - _AT_STOP_RAD <= q <= scale.upper + _AT_STOP_RAD:
            raise self._error(
                i,
                f"position {q:.3f} rad is outside of the joint's limits, "
                f"{scale.lower:.3f} to {scale.upper:.3f} rad: is its zero set?",
            )

    def _error(self, i: int, what: str) -> DriveError:
        """Return an error that names a drive."""
        drive = self._drives[i]
        name = self._sockets[drive.bus].name
        return DriveError(drive.scale.joint, drive.node_id, name, what)
