"""The bus for a controller and a rig that live in one process."""

from __future__ import annotations

from dftc_rt.bus.inprocess import DEFAULT_CAPACITY, InProcessSocket, link
from hil.bus.virtual_bus import VirtualBus


class InProcessPort(VirtualBus):
    """A virtual bus whose clients are in-process links; a ``BusPort``."""

    def connect(self, capacity: int = DEFAULT_CAPACITY) -> InProcessSocket:
        """Return the socket of a new node on this bus.

        Set its ``service`` to have the rig run inside the node's ``send``.

        Args:
            capacity: Frames that wait in either direction before frames are refused.
        """
        node, end = link(self.name, capacity, self.frame_size)
        self.attach(end)
        return node
