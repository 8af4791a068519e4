"""Set-up of moteus drives: find each one, stop it, and where it is.

A drive is configured with mjbots' own tools; nothing of that is written here. Set-up stops each
drive, which clears a fault whose cause is gone, and reads mode, position and fault code.

Source: [moteus].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from dftc_rt.bus.frame import EFF_FLAG, EFF_MASK, FD_FRAME_SIZE, Frames, unpack
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.conversation import Conversation
from dftc_rt.drives.interface import DriveConfig, SetUp
from dftc_rt.drives.moteus import codec
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus.cycle import COUNTS_PER_REV
from dftc_rt.drives.moteus.scale import scales_of
from dftc_rt.errors import DriveError

_AT_STOP_RAD: Final = 1e-3  # by which a joint at its limit may seem to be beyond it
_MOST_TURNS: Final = 1e6  # a joint without limits may have turned for years
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
        self._drives = tuple(drives)
        self._scales = scales_of(drives)
        self._conversation = Conversation(sockets, drives, timeout_s, FD_FRAME_SIZE)
        self._found = np.zeros(5)

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
                raise self._conversation.error(i, f"in fault, code {fault:.0f}")
            if mode != reg.STOPPED:
                raise self._conversation.error(i, f"does not stop: mode {mode:.0f}")
            self._check_position(i, position)
            found.counts[i] = round(position * COUNTS_PER_REV)
        self._conversation.end()
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
                self._ask(i, "query", codec.encode_query)
                mode, position, _, _, fault = self._found.tolist()
                if mode == reg.FAULTED:
                    raise self._conversation.error(i, f"in fault, code {fault:.0f}")
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

        def off(i: int) -> bool:
            self._stop(i)
            return self._found[0] in (reg.STOPPED, reg.FAULTED)

        return self._conversation.silent(off)

    def _stop(self, i: int) -> None:
        """Tell a drive to stop until its answer says so; the last answer is in ``_found``.

        Raises:
            DriveError: It did not answer; says who did.
            BusError: The bus has gone away, or takes no frame.
        """
        for _ in range(_TRIES):
            self._ask(i, "stop", codec.encode_stop)
            if self._found[0] == reg.STOPPED:
                return

    def _ask(self, i: int, what: str, encode: Callable[[Frames, int, int, int], int]) -> None:
        """Ask a drive something; its answer is in ``_found``. Errors as of ``_stop``."""
        node, host = self._drives[i].node_id, self._scales[i].host_id

        def fault(frame: Frames) -> str | None:
            can_id, data = unpack(frame[0])
            if can_id & ~EFF_FLAG != node << 8 | host:
                return f"identifier 0x{can_id & EFF_MASK:X}"
            if not codec.decode_answer(frame[0, 8:], len(data), self._found):
                return "an answer without position and velocity"
            return "an answer without mode" if math.isnan(self._found[0]) else None

        self._conversation.ask(i, what, lambda out, row: encode(out, row, node, host), fault)

    def _check_position(self, i: int, position: float) -> None:
        """Refuse a position where the joint cannot be: the drive's zero is elsewhere.

        Raises:
            DriveError: It is.
        """
        if not abs(position) <= _MOST_TURNS:
            raise self._conversation.error(i, f"position of {position:g} turns, which none can be")
        scale = self._scales[i]
        q = scale.sign * math.tau * position - scale.zero_offset_rad
        self._conversation.check_position(i, q, _AT_STOP_RAD)
