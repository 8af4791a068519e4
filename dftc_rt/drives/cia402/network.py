"""A canopen network that reads a FrameSocket when it is waited on, without threads.

canopen expects a receiving thread that fills queues. Here the wait itself receives: an
SDO client that waits for its response pumps the socket until the response is there or
time is up. Nothing runs once the call has returned.
"""

from __future__ import annotations

import contextlib
import logging
import select
import struct
import time
from collections.abc import Callable
from typing import Any

import canopen
import numpy as np
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoCommunicationError

from dftc_rt.bus.frame import FRAME_SIZE, frame_buffer, pack, unpack
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.drives.cia402 import objects as od
from dftc_rt.errors import BusError

# Without a handler, canopen's log lines would reach stderr next to the error that says
# the same in one line; an application that wants them can still ask for them.
logging.getLogger("canopen").addHandler(logging.NullHandler())

_BATCH = 64


class SocketNetwork(canopen.Network):
    """One bus as canopen's remote nodes see it.

    Attributes:
        socket: Where frames go and come from.
        timeout_s: Longest wait for an answer, s.
    """

    def __init__(self, socket: FrameSocket, timeout_s: float) -> None:
        """Attach to a socket; nothing is sent yet."""
        super().__init__()
        self.socket = socket
        self.timeout_s = timeout_s
        self._out = frame_buffer(1)
        self._in = frame_buffer(_BATCH)
        self._poll = select.poll()
        if socket.fd >= 0:
            self._poll.register(socket.fd, select.POLLIN)

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send a frame.

        Raises:
            BusError: The bus has gone away, or took no frame for ``timeout_s``.
        """
        self._out[0] = np.frombuffer(pack(can_id, bytes(data)), dtype=np.uint8)
        deadline = time.monotonic() + self.timeout_s
        while self.socket.send(self._out, 1) == 0:
            left = deadline - time.monotonic()
            if left <= 0 or self.socket.fd < 0:
                raise BusError(self.socket.name, "takes no frames (is another node on the bus?)")
            writable = select.poll()
            writable.register(self.socket.fd, select.POLLOUT)
            writable.poll(min(1000.0 * left, 10.0))

    def pump(self) -> int:
        """Hand everything that waits to canopen; return how many frames that was."""
        total = 0
        while (count := self.socket.receive(self._in)) > 0:
            total += count
            for row in range(count):
                can_id, data = unpack(self._in[row, :FRAME_SIZE])
                if can_id <= 0x7FF and not (_is_answer(can_id) and len(data) < 8):
                    # Any node may send what canopen cannot parse: an NMT state that is none, half
                    # an emergency. It says nothing about a drive, and is left out.
                    with contextlib.suppress(struct.error, LookupError, ValueError):
                        self.notify(can_id, bytearray(data), 0.0)
        return total

    def wait_for(self, done: Callable[[], bool]) -> bool:
        """Receive until something holds or ``timeout_s`` is up; return whether it holds.

        On the in-process link the other side has run when ``send`` returned, so what has
        not come by now will not come, and there is no waiting.
        """
        deadline = time.monotonic() + self.timeout_s
        while not done():
            if self.pump():
                continue
            left = deadline - time.monotonic()
            if self.socket.fd < 0 or left <= 0:
                return False
            self._poll.poll(1000.0 * left)
        return True


def _is_answer(can_id: int) -> bool:
    """Whether an identifier is that of SDO answers, which have 8 bytes."""
    return od.SDO_RESPONSE < can_id < od.SDO_RESPONSE + 0x80


class PumpedSdoClient(SdoClient):
    """canopen's SDO client, which receives while it waits."""

    def read_response(self) -> bytes:
        """Return the response to the last request.

        Raises:
            SdoCommunicationError: There was none in time.
            SdoAbortedError: The drive refused.
        """
        network = self.network
        assert isinstance(network, SocketNetwork)
        if not network.wait_for(lambda: not self.responses.empty()):
            raise SdoCommunicationError("no SDO response")
        response: bytes = super().read_response()  # type: ignore[no-untyped-call]
        return response


class PumpedNode(canopen.RemoteNode):
    """canopen's remote node with that client."""

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> PumpedSdoClient:
        """Add an SDO channel."""
        client = PumpedSdoClient(  # type: ignore[no-untyped-call]
            rx_cobid, tx_cobid, self.object_dictionary
        )
        self.sdo_channels.append(client)
        return client
