"""A CAN bus in software: every node sees every other's frames, in order of arbitration.

Transport is left to the clients' sockets, so that an in-process link and AF_UNIX
behave alike bit for bit.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.barrier import BarrierSender
from dftc_rt.bus.bits import charge
from dftc_rt.bus.fd_bits import charge_fd
from dftc_rt.bus.frame import FD_FRAME_SIZE, FRAME_SIZE, Frames, frame_buffer
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.errors import BusError, InputError
from hil.bus.arbitration import arbitrate, is_ordered, order_by_identifier
from hil.bus.client import Client
from hil.bus.impairments import CONTROLLER, Counts, Impairments
from hil.bus.statistics import EXACT, FAST, FRAMES, NOMINAL, TOTALS, WORST, BusStatistics

Timing = Literal["off", "account"]

_UNBOUNDED: Final = 1 << 30
_EXTENDED: Final = 256  # 29-bit identifiers whose latency is kept


def unpaced(timing: str) -> Timing:
    """Return a timing that needs no time to pass.

    Raises:
        InputError: It is ``pace``: in lock-step, in one process and on vcan nothing makes frames
            wait. Or it is something else.
    """
    if timing == "off":
        return "off"
    if timing == "account":
        return "account"
    raise InputError(
        "bus.timing",
        f"{timing!r} where no time passes on the wire (lock-step, one process, vcan)",
        "account or off",
    )


class VirtualBus:
    """One bus and the clients attached to it; a ``BusPort``.

    Within one ``receive`` and within one ``send``, the heads of the nodes' queues
    contend and the lowest identifier wins; a node's own frames never overtake each
    other. Timing ``off`` keeps the order of arrival instead and counts no bits.

    Attributes:
        name: Logical bus name.
        fds_version: Grows with every client that comes or leaves.
        frame_size: Bytes of a row of every buffer: 16, or 72 on a bus that carries FD frames.
    """

    def __init__(
        self,
        name: str,
        *,
        timing: Timing = "account",
        bitrate: int = 1_000_000,
        data_bitrate: int | None = None,
    ) -> None:
        """Open a bus without clients.

        Args:
            name: Logical bus name.
            timing: ``off`` or ``account``; ``pace`` is :class:`~hil.bus.paced_bus.PacedBus`.
            bitrate: Bits per second of the bus that is stood in for.
            data_bitrate: Of the data part of FD frames: the bus carries them, and all
                buffers have rows of 72 bytes. None: a classical bus.

        Raises:
            InputError: ``timing`` is something else.
        """
        unpaced(timing)
        self.name = name
        self.fds_version = 0
        self._bitrate = bitrate
        self._data_bitrate = data_bitrate
        self.frame_size = FRAME_SIZE if data_bitrate is None else FD_FRAME_SIZE
        self._account = timing == "account"
        self._clients: list[Client] = []
        self._joined = 0
        self._impairments: Impairments | None = None
        self._answer: Client | None = None
        self._barrier_sender = BarrierSender()
        self._totals = np.zeros(TOTALS, dtype=np.int64)
        self._latency = np.zeros(2048)
        self._extended = np.zeros((2, _EXTENDED))
        self._departed = 0
        self._dropped = 0
        self._malformed = 0
        self._resize(64)

    def _resize(self, rows: int) -> None:
        self._staging = frame_buffer(rows, self.frame_size)
        self._forward = frame_buffer(rows, self.frame_size)
        self._nodes = np.zeros(rows, dtype=np.int32)
        self._order = np.zeros(rows, dtype=np.int64)
        self._senders = np.zeros(0, dtype=np.int32)

    def attach(self, socket: FrameSocket) -> None:
        """Make ``socket`` the bus's end of a connection to one more node."""
        self._clients.append(Client(socket, self._joined, self.frame_size))
        self._joined += 1
        self.fds_version += 1

    def fds(self) -> list[int]:
        """Return the descriptors to wait on; empty for in-process links."""
        return [client.socket.fd for client in self._clients if client.socket.fd >= 0]

    def receive(self, frames: Frames) -> int:
        """Fill ``frames`` with what the clients sent, in wire order; return how many.

        See ``BusPort.receive``.
        """
        if self._impairments is not None:
            return self._receive_impaired(self._impairments, frames)
        clients = self._clients
        if len(clients) == 1 and clients[0].idle:
            try:
                count = clients[0].receive(frames)
            except BusError as error:
                self._leave(clients[0], error)
                return 0
        else:
            count = self._contend(frames)
            if count:
                self._pass_on(frames, count, self._senders)
        if count:
            self._charge(frames, count)
        return count

    def impair(self, impairments: Impairments) -> None:
        """Let faults of the bus act on its frames from now on."""
        self._impairments = impairments

    def advance(self, t: float) -> None:
        """Let rig time move on to ``t``, s: faults come and go, late frames arrive."""
        impairments = self._impairments
        if impairments is None:
            return
        impairments.advance(t)
        self._tell(impairments)
        if impairments.waiting(drives=True):
            self._send_impaired(impairments, self._staging, 0, self._nodes)

    def send(self, frames: Frames, count: int, nodes: NDArray[np.int32] | None = None) -> None:
        """Put the drives' first ``count`` frames on the bus. See ``BusPort.send``."""
        if count <= 0:
            return
        if self._account and not is_ordered(frames, count):
            if count > len(self._order):
                self._resize(count)
            if nodes is None:
                order_by_identifier(frames, count, self._order)
            else:
                arbitrate(frames, nodes, count, self._order)
            np.take(frames, self._order[:count], axis=0, out=self._staging[:count], mode="clip")
            frames = self._staging
            if nodes is not None:
                nodes = nodes[self._order[:count]]
        if self._impairments is not None:
            senders = np.zeros(count, dtype=np.int32) if nodes is None else nodes
            self._send_impaired(self._impairments, frames, count, senders)
            return
        self._charge(frames, count)
        for client in tuple(self._clients):
            self._deliver(client, frames, count)

    @property
    def barrier_pending(self) -> bool:
        """Whether some client has ended its share of the cycle."""
        for client in self._clients:  # noqa: SIM110 - asked several times a cycle
            if client.barrier is not None:
                return True
        return False

    @property
    def barrier_cycle(self) -> int | None:
        """Cycle of the barrier that ``pop_barrier`` would return; None: no barrier waits."""
        for client in self._clients:
            if client.barrier is not None:
                return client.barrier
        return None

    def pop_barrier(self) -> int | None:
        """Return the cycle of the barrier that waits, and let its client go on; or None."""
        for client in self._clients:
            if client.barrier is not None:
                cycle, client.barrier = client.barrier, None
                self._answer = client
                return cycle
        return None

    def send_barrier(self, cycle: int) -> None:
        """Answer the client whose barrier was popped last. See ``BusPort.send_barrier``.

        A client so far behind that not even its barrier finds room is disconnected: it
        would wait for ever.
        """
        client, self._answer = self._answer, None
        if client is None:
            raise RuntimeError(f"{self.name}: no barrier to answer")
        if client not in self._clients:
            return
        try:
            accepted = self._barrier_sender.send(client.socket, cycle)
        except BusError as error:
            self._leave(client, error)
            return
        if not accepted:
            self._leave(client, BusError(self.name, "no room for the barrier"))

    def count_into(self, totals: NDArray[np.int64]) -> None:
        """Keep the counts of frames and bits there from now on. See ``BusPort.count_into``."""
        totals[:] = self._totals
        self._totals = totals

    @property
    def statistics(self) -> BusStatistics:
        """What has gone over the bus since it was opened."""
        done = Counts() if self._impairments is None else self._impairments.counts
        return BusStatistics(
            bitrate=self._bitrate,
            frames=int(self._totals[FRAMES]),
            nominal_bits=int(self._totals[NOMINAL]),
            exact_bits=int(self._totals[EXACT]),
            worst_bits=int(self._totals[WORST]),
            data_bitrate=self._data_bitrate or 0,
            nominal_data_bits=int(self._totals[FAST + NOMINAL]),
            exact_data_bits=int(self._totals[FAST + EXACT]),
            worst_data_bits=int(self._totals[FAST + WORST]),
            latency_us={
                f"0x{number:03x}": round(1e6 * float(self._latency[number]), 1)
                for number in np.flatnonzero(self._latency)
            }
            | {
                f"0x{int(number):08x}": round(1e6 * float(longest), 1)
                for number, longest in self._extended.T
                if longest
            },
            dropped=self._dropped + sum(client.dropped for client in self._clients),
            malformed=self._malformed + sum(client.malformed for client in self._clients),
            clients=len(self._clients),
            departed=self._departed,
            lost=done.lost,
            errors=done.errors,
            duplicated=done.duplicated,
            delayed=done.delayed,
            babbled=done.babbled,
        )

    def close(self) -> None:
        """Close every connection; a second call does nothing."""
        for client in self._clients:
            client.socket.close()
        self._clients.clear()
        self.fds_version += 1

    def _contend(self, frames: Frames) -> int:
        """Let the clients' queues contend for ``frames``; ``_senders`` says whose won."""
        limit = len(frames)
        contenders: list[tuple[Client, Frames]] = []
        for client in tuple(self._clients):
            try:
                queue = client.waiting()
            except BusError as error:
                self._leave(client, error)
                continue
            if len(queue):
                contenders.append((client, queue[:limit]))
        if not contenders:
            return 0
        total = sum(len(queue) for _, queue in contenders)
        if total > len(self._order):
            self._resize(total)
        end = 0
        for node, (_, queue) in enumerate(contenders):
            self._staging[end : end + len(queue)] = queue
            self._nodes[end : end + len(queue)] = node
            end += len(queue)
        if self._account and len(contenders) > 1:
            arbitrate(self._staging, self._nodes, total, self._order)
        else:
            self._order[:total] = np.arange(total)
        count = min(total, limit)
        won = self._order[:count]
        frames[:count] = self._staging[won]
        senders = self._nodes[won]
        for node, (client, _) in enumerate(contenders):
            client.won(int(np.count_nonzero(senders == node)))
        numbers = np.array([CONTROLLER - client.number for client, _ in contenders], dtype=np.int32)
        self._senders = numbers[senders]
        return count

    def _pass_on(self, frames: Frames, count: int, senders: NDArray[np.int32]) -> None:
        """Deliver to every client what others sent."""
        for client in tuple(self._clients):
            own = senders[:count] == CONTROLLER - client.number
            if not own.any():
                self._deliver(client, frames, count)
                continue
            foreign = frames[:count][~own]
            self._forward[: len(foreign)] = foreign
            self._deliver(client, self._forward, len(foreign))

    def _receive_impaired(self, impairments: Impairments, frames: Frames) -> int:
        """What :meth:`receive` does while faults act on the bus."""
        limit = len(frames)
        count = self._contend(frames)
        wasted = impairments.counts.waste
        through, count, senders = impairments.carry(
            frames, count, self._senders, limit, drives=False
        )
        self._waste(wasted, impairments.counts.waste)
        self._tell(impairments)
        frames[:count] = through[:count]
        if count:
            self._charge(frames, count)
            if not impairments.off(CONTROLLER):
                self._pass_on(frames, count, senders)
        return count

    def _send_impaired(
        self, impairments: Impairments, frames: Frames, count: int, nodes: NDArray[np.int32]
    ) -> None:
        """What :meth:`send` does while faults act on the bus."""
        wasted = impairments.counts.waste
        through, count, _ = impairments.carry(frames, count, nodes, _UNBOUNDED, drives=True)
        self._waste(wasted, impairments.counts.waste)
        self._tell(impairments)
        self._charge(through, count)
        if impairments.off(CONTROLLER):
            impairments.counts.lost += count
            return
        for client in tuple(self._clients):
            self._deliver(client, through, count)

    def _tell(self, impairments: Impairments) -> None:
        """Hand every client the error frames of its interface; none was ever on the wire."""
        if not impairments.notices:
            return
        notices = frame_buffer(len(impairments.notices), self.frame_size)
        for row, raw in enumerate(impairments.notices):
            notices[row, :FRAME_SIZE] = np.frombuffer(raw, dtype=np.uint8)
        impairments.notices.clear()
        for client in tuple(self._clients):
            self._hand(client, notices, len(notices))  # filters say nothing about error frames

    def _waste(self, before: tuple[int, int], after: tuple[int, int]) -> None:
        """Charge transmissions that nobody took."""
        if self._account:
            for column in (EXACT, WORST):
                self._totals[column] += after[0] - before[0]
                self._totals[FAST + column] += after[1] - before[1]

    def _deliver(self, client: Client, frames: Frames, count: int) -> None:
        if client.filters is not None:
            frames, count = client.chosen(frames, count, client.filters)
        self._hand(client, frames, count)

    def _hand(self, client: Client, frames: Frames, count: int) -> None:
        try:
            client.dropped += count - client.socket.send(frames, count)
        except BusError as error:
            self._leave(client, error)

    def _leave(self, client: Client, reason: BusError) -> None:
        """Forget a client that has gone. ``reason`` says why, for a port that minds."""
        client.socket.close()
        self._clients.remove(client)
        self._departed += 1
        self._dropped += client.dropped
        self._malformed += client.malformed
        self.fds_version += 1

    def _charge(self, frames: Frames, count: int) -> None:
        if self._account and self._data_bitrate is not None:
            bit_s, data_bit_s = 1.0 / self._bitrate, 1.0 / self._data_bitrate
            charge_fd(frames, count, self._totals, bit_s, data_bit_s, self._latency, self._extended)
        elif self._account:
            charge(frames, count, self._totals, 1.0 / self._bitrate, self._latency)
        else:
            self._totals[FRAMES] += count
