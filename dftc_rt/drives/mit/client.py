"""Set-up of MIT drives: find each one, at rest, and where it is.

There is nothing to configure over the bus, and nothing to ask but the state, which every
frame is answered with. So set-up takes each drive out of motor mode and reads its answer;
ranges cannot be checked (:mod:`dftc_rt.drives.mit.scale`), the position can.

Everything here happens before the loop starts and after it has ended, in the caller's
thread; it may raise, wait and allocate. On success it depends on no clock.

Source: [katz2018].
"""

from __future__ import annotations

import select
import time
from collections.abc import Sequence
from typing import Final

import numpy as np

from dftc_rt.bus.frame import ERR_FLAG, frame_buffer, unpack
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.interface import DriveConfig, SetUp
from dftc_rt.drives.mit import codec
from dftc_rt.drives.mit.scale import P_MAX, scales_of, wire_table
from dftc_rt.errors import BusError, DriveError, InputError

_SHUTDOWN_TIMEOUT_S: Final = 0.1  # a drive that is there answers at once
_BATCH: Final = 64
_TIMES: Final = 2
"""How often a drive is told. One frame may be lost; and a rig in lock-step, which keeps an answer
until the controller ends its cycle, sees by the second one that no cycle is going on."""
_LAST_CODE: Final = (1 << codec.P_BITS) - 1


class MitClient:
    """The controller's side of all MIT drives of a robot, outside of the loop."""

    def __init__(
        self,
        sockets: Sequence[FrameSocket],
        drives: Sequence[DriveConfig],
        rate_hz: float,
        timeout_s: float = 1.0,
    ) -> None:
        """Attach to the buses; nothing is sent yet.

        Args:
            sockets: One per bus.
            drives: The drives, in joint order, with the ranges of ``MitScale``.
            rate_hz: Cycles per second; a drive is not told it.
            timeout_s: Longest wait for one answer, s.

        Raises:
            InputError: Two drives of a bus share a node id, or one has no ranges.
        """
        self._sockets = list(sockets)
        self._drives = tuple(drives)
        self._scales = scales_of(drives)
        self._wire = wire_table(self._scales)
        self._timeout_s = timeout_s
        self._out = frame_buffer(_TIMES)
        self._in = frame_buffer(_BATCH)
        taken: set[tuple[int, int]] = set()
        for drive in drives:
            if (drive.bus, drive.node_id) in taken:
                where = self._sockets[drive.bus].name
                raise InputError(drive.scale.joint, f"node id {drive.node_id} is taken on {where}")
            taken.add((drive.bus, drive.node_id))

    def configure(self) -> SetUp:
        """Take every drive out of motor mode, and find out where it is.

        Raises:
            DriveError: A drive is missing, answers as another, reports an error, or is
                where its joint cannot be.
            BusError: A bus has gone away.
        """
        n = len(self._drives)
        at_rest = int(states.STATE_BITS[states.SWITCHED_ON])
        found = SetUp(np.full(n, at_rest, dtype=np.int64), np.zeros(n, dtype=np.int64))
        for i in range(n):
            answer = self._leave(i)
            if len(answer) >= codec.LONG_ANSWER and answer[7]:
                raise self._error(i, f"reports error {answer[7]}")
            found.counts[i] = answer[1] << 8 | answer[2]
            self._check_position(i, int(found.counts[i]))
        for socket in self._sockets:
            self._drain(socket)
        return found

    def examine(self) -> tuple[str, ...]:
        """Refuse: whatever makes a drive answer also commands it.

        Raises:
            InputError: Always.
        """
        raise InputError("--ask", "MIT drives answer to commands alone", "--listen without it")

    def shutdown(self) -> tuple[str, ...]:
        """Take every drive out of motor mode, best effort.

        Returns:
            Joints whose drive did not confirm.
        """
        silent = []
        self._timeout_s = min(self._timeout_s, _SHUTDOWN_TIMEOUT_S)
        for i, drive in enumerate(self._drives):
            try:
                self._leave(i)
            except (DriveError, BusError):
                silent.append(drive.scale.joint)
        return tuple(silent)

    def _leave(self, i: int) -> bytes:
        """Tell a drive to leave motor mode and return the data of its answer.

        Raises:
            DriveError: It did not answer; says who did.
            BusError: The bus has gone away, or takes no frame.
        """
        drive, socket = self._drives[i], self._sockets[self._drives[i].bus]
        self._drain(socket)  # what a loop before has left is no answer to this
        for row in range(_TIMES):
            codec.encode_special(self._out, row, drive.node_id, codec.LEAVE)
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
                if can_id != self._scales[i].host_id:
                    heard.append(f"identifier 0x{can_id:X}")
                elif len(data) < codec.SHORT_ANSWER:
                    heard.append(f"an answer of {len(data)} bytes")
                elif data[0] != drive.node_id:
                    heard.append(f"node {data[0]}")
                else:
                    return data
            if not count and not self._wait(socket, deadline, select.POLLIN):
                who = f"; heard {', '.join(dict.fromkeys(heard))}" if heard else ""
                raise self._error(
                    i, f"no answer to 'leave motor mode' within {self._timeout_s:g} s{who}"
                )

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

    def _check_position(self, i: int, code: int) -> None:
        """Refuse a position where the joint cannot be: the drive's zero is elsewhere."""
        scale = self._scales[i]
        if code in (0, _LAST_CODE) and not scale.wraps:
            raise self._error(
                i, f"position at the end of its range, ±{scale.p_max:g} rad: is its zero set?"
            )
        q = codec.position_of(code, self._wire, i)
        step = 2.0 * float(self._wire[P_MAX, i]) / _LAST_CODE
        if not scale.lower - step <= q <= scale.upper + step:
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
