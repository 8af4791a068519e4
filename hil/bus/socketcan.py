"""The rig's end of a bus that the kernel carries: a vcan interface, and nothing else."""

from __future__ import annotations

from dftc_rt.bus.link_kind import link_kind
from dftc_rt.bus.socketcan import SocketCanSocket
from dftc_rt.errors import BusError, InputError
from hil.bus.client import Client
from hil.bus.virtual_bus import Timing, VirtualBus


class SocketCanPort(VirtualBus):
    """A port on a vcan interface; a ``BusPort``.

    The kernel joins the nodes, so all of them together are the one client of this
    port: ``fds`` never changes, the order of arrival is the kernel's, a barrier is seen
    by every node, and frames that a slow node loses are lost in the kernel, uncounted.
    """

    def __init__(
        self,
        name: str,
        interface: str,
        *,
        timing: Timing = "account",
        bitrate: int = 1_000_000,
        data_bitrate: int | None = None,
    ) -> None:
        """Open ``interface``.

        Args:
            name: Logical bus name (``can0``).
            interface: vcan interface (``vcan0``).
            timing: ``off`` or ``account``.
            bitrate: Bits per second of the bus that is stood in for.
            data_bitrate: Of the data part of FD frames; None: a classical bus.

        Raises:
            InputError: The interface is of another kind than vcan: the rig must never
                reach a real bus.
            BusError: There is no such interface, or it is down.
            EnvironmentLacksError: The kernel has no SocketCAN.
        """
        kind = link_kind(interface)
        if kind is None:
            raise BusError(name, f"there is no interface {interface}")
        if kind != "vcan":
            raise InputError(interface, f"a link of kind {kind or 'hardware'}", "kind vcan")
        super().__init__(name, timing=timing, bitrate=bitrate, data_bitrate=data_bitrate)
        self.attach(SocketCanSocket(name, interface, fd=data_bitrate is not None))

    def _leave(self, client: Client, reason: BusError) -> None:
        super()._leave(client, reason)
        raise reason
