"""An emulated drive's SDO server: canopen's, with the transfers' own rules kept.

canopen's answers a segment that belongs to no transfer, finds out at the last segment that an
object cannot be written, and waits for the next segment for ever.

Source: CiA 301, "SDO protocols", "Abort SDO transfer protocol".
"""

from __future__ import annotations

import sys
from typing import Final

import canopen
from canopen.objectdictionary import NUMBER_TYPES
from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

from hil.drive import aborts
from hil.drive.silent_network import NEVER, SilentNetwork

TIMEOUT_US: Final = 1_000_000
"""Longest wait for the next segment, us of rig time."""

_EXPEDITED: Final = 0x02
_SIZE_GIVEN: Final = 0x01
_LAST: Final = 0x01
_UPLOAD, _DOWNLOAD = "upload", "download"


class DriveSdoServer(SdoServer):
    """One transfer at a time.

    Attributes:
        due_us: Rig time at which the transfer that is open times out; NEVER without one.
    """

    def __init__(self, rx_cobid: int, tx_cobid: int, node: canopen.LocalNode) -> None:
        super().__init__(rx_cobid, tx_cobid, node)  # type: ignore[no-untyped-call]
        self.forget()

    def forget(self) -> None:
        """Drop the transfer that is open, if any, without a word."""
        self._index = 0
        self._subindex = 0
        self._received = 0  # bytes
        self._buffer = bytearray()
        self._open = ""
        self.due_us = NEVER

    def abort(self, abort_code: int = aborts.GENERAL) -> None:
        """End a transfer; an error of our own is raised, where canopen would log it."""
        error = sys.exception()
        if abort_code == aborts.GENERAL and error is not None:
            raise error
        super().abort(abort_code)  # type: ignore[no-untyped-call]
        self.forget()

    def time_out(self) -> None:
        """Abort the transfer that is open: the client has left it."""
        self.abort(aborts.TIMED_OUT)

    def init_upload(self, request: bytearray) -> None:
        """Begin an upload; what was open before is dropped."""
        self.forget()
        super().init_upload(request)  # type: ignore[no-untyped-call]
        if self._buffer:
            self._continue(_UPLOAD)

    def segmented_upload(self, command: int) -> None:
        """Send the next segment.

        Raises:
            SdoAbortedError: No upload is open, or the toggle bit is wrong.
        """
        self._require(_UPLOAD)
        super().segmented_upload(command)  # type: ignore[no-untyped-call]
        if not self._buffer:
            self.forget()

    def init_download(self, request: bytearray) -> None:
        """Begin a download; what was open before is dropped.

        Raises:
            SdoAbortedError: The object cannot be written, or not with so many bytes.
        """
        self.forget()
        command, self._index, self._subindex = (
            request[0],
            int.from_bytes(request[1:3], "little"),
            request[3],
        )
        if not command & _EXPEDITED:
            variable = self._node._find_object(self._index, self._subindex)
            if not variable.writable:
                raise SdoAbortedError(aborts.READ_ONLY)
            size = int.from_bytes(request[4:8], "little")
            number = variable.data_type in NUMBER_TYPES
            if command & _SIZE_GIVEN and number and 8 * size != len(variable):
                raise SdoAbortedError(aborts.WRONG_LENGTH)
        super().init_download(request)  # type: ignore[no-untyped-call]
        if not command & _EXPEDITED:
            self._continue(_DOWNLOAD)

    def segmented_download(self, command: int, request: bytearray) -> None:
        """Take the next segment.

        Raises:
            SdoAbortedError: No download is open, the toggle bit or the length is wrong, or the
                value is refused.
        """
        self._require(_DOWNLOAD)
        variable = self._node._find_object(self._index, self._subindex)
        self._received += 7 - (command >> 1 & 7)
        if 8 * self._received > len(variable):
            raise SdoAbortedError(aborts.TOO_LONG)
        super().segmented_download(command, request)  # type: ignore[no-untyped-call]
        if command & _LAST:
            self.forget()

    def request_aborted(self, data: bytearray) -> None:
        """Let the client end its transfer."""
        super().request_aborted(data)  # type: ignore[no-untyped-call]
        self.forget()

    def _require(self, what: str) -> None:
        if self._open != what:
            raise SdoAbortedError(aborts.UNKNOWN_COMMAND)
        self._continue(what)

    def _continue(self, what: str) -> None:
        assert isinstance(self.network, SilentNetwork)
        self._open = what
        self.due_us = self.network.now_us + TIMEOUT_US
