"""Faults that come while the rig runs: taken from a socket, one request a cycle at most.

A request that is no good is answered with one line and counted, and changes nothing. What is done
is an event with the fault as JSON, so that a log tells all that was broken
(:func:`dftc_rt.analysis.faults.all_faults`).
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec

from dftc_rt import fault_socket
from dftc_rt.config.faults import Fault, OnBus, RestartFault, RobotFault
from dftc_rt.errors import InputError
from dftc_rt.fault_socket import DATAGRAM_BYTES, Answer, Apply, Request, fault_table, kind_of

_MOST: Final = 64  # that came this way and are not over
_WARNING: Final = 2
_LATE: Final = 60.0  # s of rig time after its end, from which on a fault is forgotten


class FaultDesk:
    """Takes requests, and tells the rig which faults there are.

    Attributes:
        refused: Requests that were no good.
    """

    def __init__(
        self,
        directory: Path,
        scenario: Sequence[Fault],
        change: Callable[[Sequence[Fault]], None],
        event: Callable[[float, int, str, str], object],
    ) -> None:
        """Listen.

        Args:
            directory: Where the socket is to lie.
            scenario: Faults that the rig has from the start.
            change: Gives the rig others; may raise InputError, and has changed nothing then.
            event: Takes events.

        Raises:
            InputError: The socket cannot be made.
        """
        self._directory = directory
        self._socket = fault_socket.listen(directory)
        self._scenario = [fault for fault in scenario if not isinstance(fault, OnBus)]
        self._added: list[RobotFault] = []
        self._change = change
        self._event = event
        self._decoder = msgspec.json.Decoder(Request)
        self.refused = 0

    def take(self, t: float) -> None:
        """Do what is asked at rig time ``t``, s: one request at most. Never blocks."""
        try:
            raw, sender = self._socket.recvfrom(DATAGRAM_BYTES, socket.MSG_DONTWAIT)
        except OSError:  # nothing there
            return
        try:
            answer = Answer(t=t, text=self._do(self._decoder.decode(raw), t))
        except (InputError, msgspec.DecodeError, UnicodeDecodeError) as error:
            self.refused += 1
            answer = Answer(t=t, refused=" ".join(str(error).split())[:400])
        if sender:
            with contextlib.suppress(OSError):  # whoever does not wait for it
                self._socket.sendto(msgspec.json.encode(answer), socket.MSG_DONTWAIT, sender)

    def close(self) -> None:
        """Stop listening."""
        fault_socket.close(self._socket, self._directory)

    def _do(self, request: Request, t: float) -> str:
        """Do what is asked; return what that was.

        Raises:
            InputError: It cannot be done.
        """
        if isinstance(request, Apply):
            return self._apply(request.fault, t)
        return self._clear(request.joint, request.kind, t)

    def _apply(self, fault: RobotFault, t: float) -> str:
        replace = msgspec.structs.replace
        fault = replace(fault, start_s=t + fault.start_s)
        if not isinstance(fault, RestartFault):
            fault = replace(fault, end_s=min(t + fault.end_s, 1e9))
        kept = [old for old in self._added if not _same(old, fault) and old.end_s > t - _LATE]
        if len(kept) >= _MOST:
            raise InputError("fault", f"{_MOST} at a time", "some to be cleared first")
        self._change([*self._scenario, *kept, fault])
        self._added = [*kept, fault]
        self._tell(t, "applied", fault)
        return f"{kind_of(fault)} on {fault.joint or 'the arm'} from {fault.start_s:.3f} s"

    def _clear(self, joint: str | None, kind: str | None, t: float) -> str:
        ended: list[RobotFault] = []

        def left(faults: Sequence[RobotFault]) -> list[RobotFault]:
            kept = []
            for fault in faults:
                ends = not isinstance(fault, RestartFault)
                fits = joint in (None, fault.joint) and kind in (None, kind_of(fault))
                if ends and fits and fault.end_s > t:
                    begun = fault.start_s < t
                    fault = msgspec.structs.replace(fault, end_s=t)
                    ended.append(fault)
                    if not begun:
                        continue
                kept.append(fault)
            return kept

        scenario, added = left(self._scenario), left(self._added)
        if not ended:
            raise InputError("clear", "no such fault is active", "what was applied before")
        self._change([*scenario, *added])
        self._scenario, self._added = scenario, added
        for fault in ended:
            self._tell(t, "cleared", fault)
        return "ended: " + ", ".join(f"{kind_of(f)} on {f.joint or 'the arm'}" for f in ended)

    def _tell(self, t: float, what: str, fault: RobotFault) -> None:
        text = msgspec.json.encode(fault_table(fault)).decode()
        self._event(t, _WARNING, "rig", f"fault {what}: {text}")


def _same(one: RobotFault, other: RobotFault) -> bool:
    return type(one) is type(other) and one.joint == other.joint
