"""Set-up of MIT drives: find each one, at rest, and where it is.

There is nothing to configure over the bus, and nothing to ask but the state, which every
frame is answered with. So set-up takes each drive out of motor mode and reads its answer;
ranges cannot be checked (:mod:`dftc_rt.drives.mit.scale`), the position can.

Source: [katz2018].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from dftc_rt.bus.frame import Frames, unpack
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.conversation import Conversation
from dftc_rt.drives.interface import DriveConfig, SetUp
from dftc_rt.drives.mit import codec
from dftc_rt.drives.mit.scale import P_MAX, scales_of, wire_table
from dftc_rt.errors import InputError

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
        self._drives = tuple(drives)
        self._scales = scales_of(drives)
        self._wire = wire_table(self._scales)
        self._conversation = Conversation(sockets, drives, timeout_s)

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
                raise self._conversation.error(i, f"reports error {answer[7]}")
            found.counts[i] = answer[1] << 8 | answer[2]
            self._check_position(i, int(found.counts[i]))
        self._conversation.end()
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
        return self._conversation.silent(lambda i: bool(self._leave(i)))

    def _leave(self, i: int) -> bytes:
        """Tell a drive to leave motor mode and return the data of its answer.

        Raises:
            DriveError: It did not answer; says who did.
            BusError: The bus has gone away, or takes no frame.
        """
        node = self._drives[i].node_id

        def leave(out: Frames, row: int) -> None:
            codec.encode_special(out, row, node, codec.LEAVE)

        def fault(frame: Frames) -> str | None:
            can_id, data = unpack(frame[0])
            if can_id != self._scales[i].host_id:
                return f"identifier 0x{can_id:X}"
            if len(data) < codec.SHORT_ANSWER:
                return f"an answer of {len(data)} bytes"
            return None if data[0] == node else f"node {data[0]}"

        return unpack(self._conversation.ask(i, "leave motor mode", leave, fault)[0])[1]

    def _check_position(self, i: int, code: int) -> None:
        """Refuse a position where the joint cannot be: the drive's zero is elsewhere."""
        scale = self._scales[i]
        if code in (0, _LAST_CODE) and not scale.wraps:
            raise self._conversation.error(
                i, f"position at the end of its range, ±{scale.p_max:g} rad: is its zero set?"
            )
        q = codec.position_of(code, self._wire, i)
        step = 2.0 * float(self._wire[P_MAX, i]) / _LAST_CODE
        self._conversation.check_position(i, q, step)
