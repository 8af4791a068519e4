"""Set-up of drives that answer every frame: one drive at a time, a question and its answer.

Outside of the loop: it may raise, wait and allocate. On success it depends on no clock.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Sequence
from typing import Final

from dftc_rt.bus.frame import ERR_FLAG, FRAME_SIZE, Frames, frame_buffer, unpack
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.membership import refuse_shared_nodes
from dftc_rt.drives.polled_scale import PolledScale
from dftc_rt.errors import BusError, DriveError

_SHUTDOWN_TIMEOUT_S: Final = 0.1  # a drive that is there answers at once
_BATCH: Final = 64
_TIMES: Final = 2  # how often a drive is told at a time: one frame may be lost


class Conversation:
    """Asks drives, and says in one line which of them does not answer, or answers wrongly."""

    def __init__(
        self,
        sockets: Sequence[FrameSocket],
        drives: Sequence[DriveConfig],
        timeout_s: float,
        frame_size: int = FRAME_SIZE,
    ) -> None:
        """Attach to the buses; nothing is sent yet.

        Args:
            sockets: One per bus.
            drives: The drives, in joint order.
            timeout_s: Longest wait for one answer, s.
            frame_size: Bytes of a row of every buffer.

        Raises:
            InputError: Two drives of a bus share a node id.
        """
        self._sockets = list(sockets)
        self._drives = tuple(drives)
        self._timeout_s = timeout_s
        self._out = frame_buffer(_TIMES, frame_size)
        self._in = frame_buffer(_BATCH, frame_size)
        refuse_shared_nodes(drives, [socket.name for socket in sockets])

    def ask(
        self,
        i: int,
        what: str,
        encode: Callable[[Frames, int], object],
        fault: Callable[[Frames], str | None],
    ) -> Frames:
        """Tell a drive something and return its first answer, one row.

        Args:
            i: The drive.
            what: What it is told, for the error.
            encode: Fills a row of a batch.
            fault: Why a row is not the answer; None: it is.

        Raises:
            DriveError: It did not answer; says who did.
            BusError: The bus has gone away, or takes no frame.
        """
        socket = self._sockets[self._drives[i].bus]
        self._drain(socket)  # what a loop before has left is no answer to this
        for row in range(_TIMES):
            encode(self._out, row)
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
                if unpack(self._in[row])[0] & ERR_FLAG:
                    continue
                other = fault(self._in[row : row + 1])
                if other is None:
                    return self._in[row : row + 1]
                heard.append(other)
            if not count and not self._wait(socket, deadline, select.POLLIN):
                who = f"; heard {', '.join(dict.fromkeys(heard))}" if heard else ""
                raise self.error(i, f"no answer to '{what}' within {self._timeout_s:g} s{who}")

    def end(self) -> None:
        """Receive what still waits on any bus, and forget it."""
        for socket in self._sockets:
            self._drain(socket)

    def silent(self, off: Callable[[int], bool]) -> tuple[str, ...]:
        """Go through all drives at the end; return the joints whose drive did not confirm.

        Args:
            off: Tells a drive to be off, and says whether it is; may raise as :meth:`ask` does.
        """
        self._timeout_s = min(self._timeout_s, _SHUTDOWN_TIMEOUT_S)
        found = []
        for i, drive in enumerate(self._drives):
            try:
                confirmed = off(i)
            except (DriveError, BusError):
                confirmed = False
            if not confirmed:
                found.append(drive.scale.joint)
        return tuple(found)

    def check_position(self, i: int, q: float, tolerance: float) -> None:
        """Refuse a position where the joint cannot be: the drive's zero is elsewhere.

        Args:
            i: The drive; its scale is a ``PolledScale``.
            q: Position, rad (m).
            tolerance: By which a joint at its limit may seem to be beyond it, rad (m).

        Raises:
            DriveError: It is outside of the joint's limits.
        """
        scale = self._drives[i].scale
        assert isinstance(scale, PolledScale)
        if not scale.lower - tolerance <= q <= scale.upper + tolerance:
            raise self.error(
                i,
                f"position {q:.3f} rad is outside of the joint's limits, "
                f"{scale.lower:.3f} to {scale.upper:.3f} rad: is its zero set?",
            )

    def error(self, i: int, what: str) -> DriveError:
        """Return an error that names a drive."""
        drive = self._drives[i]
        name = self._sockets[drive.bus].name
        return DriveError(drive.scale.joint, drive.node_id, name, what)

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
