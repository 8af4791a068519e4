"""The executor's view of the drives: one exchange of frames a cycle, over several buses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.barrier import find_barrier
from dftc_rt.bus.frame import BARRIER_ID, Frames, frame_buffer, unpack
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.bus.wait import Waiter
from dftc_rt.drives.cia402 import codec, states
from dftc_rt.drives.cia402.objects import MASTER_NODE_ID, OPERATIONAL, SYNC_COUNTER_OVERFLOW
from dftc_rt.drives.cia402.states import (
    CW_DISABLE_VOLTAGE,
    CW_ENABLE_OPERATION,
    CW_QUICK_STOP,
)
from dftc_rt.drives.scale import ScaleTable, quantise_torque
from dftc_rt.errors import BusError
from dftc_rt.rt.clock import NS, Clock

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_CAPACITY: Final = 256
_LOCKSTEP_PATIENCE_S: Final = 1.0  # between looks; a rig that dies closes the bus
_LIVE: Final = (states.OPERATION_ENABLED, states.QUICK_STOP_ACTIVE)


class Phase(IntEnum):
    """What the drives are told besides the torque."""

    ENABLE = CW_ENABLE_OPERATION
    DISABLE = CW_DISABLE_VOLTAGE
    QUICK_STOP = CW_QUICK_STOP


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _begin(words: I64) -> None:
    for i in range(words.shape[1]):
        words[codec.W_SEEN, i] = 0


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _missing(words: I64) -> int:
    count = 0
    for i in range(words.shape[1]):
        if not words[codec.W_SEEN, i] & 1:
            count += 1
    return count


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _age(words: I64, age: F64) -> None:
    for i in range(words.shape[1]):
        age[i] = 0.0 if words[codec.W_SEEN, i] & 1 else age[i] + 1.0


@dataclass(slots=True)
class _Bus:
    """One bus: its socket, its joints, its buffers."""

    socket: FrameSocket
    members: I64
    lookup: NDArray[np.int32]
    commands: Frames
    inbox: Frames
    other: NDArray[np.uint8]


class DriveLink:
    """Exchanges SYNC, feedback and commands with CiA 402 drives.

    Attributes:
        q: Measured position, (n,), rad.
        v: Measured velocity, (n,), rad/s.
        age: Age of the measurement, (n,), cycles; 0 when it came this cycle.
        status: (n,), int64.
        torque_actual: What the drives report, (n,), Nm; it does not know a loss.
        sent: Torque as sent, after limiting and quantisation, (n,), Nm.
        phase: What the drives are told besides the torque.
        missed: Answers that did not come in time, over all joints and cycles.
    """

    def __init__(
        self,
        sockets: Sequence[FrameSocket],
        members: Sequence[I64],
        node_ids: I64,
        scales: ScaleTable,
        clock: Clock,
        period_s: float,
        read_budget_s: float,
        event: Callable[[str, str], object],
    ) -> None:
        """Prepare buffers; the drives must be configured already.

        Args:
            sockets: One a bus.
            members: Joints on each bus, (m,) each.
            node_ids: Of all joints, (n,).
            scales: Scale of each joint's drive.
            clock: Decides how the exchange waits: for a barrier in lock-step, for the
                read budget otherwise.
            period_s: Control period, s.
            read_budget_s: Longest wait for answers from the tick on, s.
            event: Called as (source, text) for what a drive says besides its answers.
        """
        n = node_ids.shape[0]
        self._clock = clock
        self._lockstep = clock.lockstep
        self._scale = scales.values
        self._node_ids = node_ids
        self._event = event
        self._values = np.zeros((codec.F_ROWS, n))
        self._words = np.zeros((codec.W_ROWS, n), dtype=np.int64)
        self._budget_ns = round(read_budget_s * NS)
        # The longest period that still gives the drives two chances before they give up.
        self._heartbeat_cycles = max(round(0.05 / period_s), 1)
        self.q, self.v = self._values[codec.F_Q], self._values[codec.F_V]
        self.torque_actual = self._values[codec.F_TORQUE]
        self.status = self._words[codec.W_STATUS]
        self.age = np.zeros(n)
        self.sent = np.zeros(n)
        self._counts = np.zeros(n, dtype=np.int64)
        self._controlword = np.zeros(n, dtype=np.int64)
        self.phase = Phase.ENABLE
        self.missed = 0
        self._buses = [
            _Bus(
                socket,
                member,
                codec.feedback_lookup(member, node_ids),
                frame_buffer(member.shape[0]),
                frame_buffer(_CAPACITY),
                np.zeros(_CAPACITY, dtype=np.uint8),
            )
            for socket, member in zip(sockets, members, strict=True)
        ]
        self._waiter = Waiter([socket.fd for socket in sockets])
        # SYNC, then in lock-step the barrier; and the same behind a heartbeat.
        self._head = frame_buffer(3)
        self._barrier_words = self._head.view("<u8")
        codec.encode_heartbeat(self._head, 0, MASTER_NODE_ID, OPERATIONAL)
        codec.encode_sync(self._head, 1, 1)
        self._head[2, 0:4] = np.frombuffer(BARRIER_ID.to_bytes(4, "little"), dtype=np.uint8)
        self._head[2, 4] = 8
        self._tail = self._head[1:]

    def start(self, q: F64) -> None:
        """Take positions read during set-up, (n,), rad, as the first feedback, at rest."""
        self.q[:] = q
        self.v[:] = 0.0

    def exchange(self, cycle: int, deadline: int) -> None:
        """Send SYNC on every bus and collect the answers. Real-time safe.

        Args:
            cycle: Number of this cycle, from 0.
            deadline: The tick, ns; the read budget counts from it, or from now if later.

        Raises:
            BusError: A bus has gone away.
        """
        words = self._words
        if not self._lockstep:
            for bus in self._buses:  # answers to an earlier tick are never new
                self._take(bus)
        _begin(words)
        head, rows = self._tail, 1
        if cycle % self._heartbeat_cycles == 0:
            head, rows = self._head, 2
        self._barrier_words[1, 1] = cycle % SYNC_COUNTER_OVERFLOW + 1
        if self._lockstep:
            self._barrier_words[2, 1] = cycle
            rows += 1
        for bus in self._buses:
            bus.socket.send(head, rows)
        if self._lockstep:
            for bus in self._buses:
                self._until_barrier(bus)
        else:
            self._until_answered(max(deadline, self._clock.now()) + self._budget_ns)
        missing = _missing(words)
        if missing:
            self.missed += missing
        _age(words, self.age)

    def command(self, tau: F64) -> None:
        """Send the torque and the controlword of the phase to every drive. Real-time safe.

        Args:
            tau: Torque, (n,), Nm; sent as zero unless the phase is to enable.

        Raises:
            BusError: A bus has gone away.
        """
        quantise_torque(tau, self._scale, self._counts, self.sent)
        if self.phase is not Phase.ENABLE:
            self._counts[:] = 0
            self.sent[:] = 0.0
        self._controlword[:] = int(self.phase)
        for bus in self._buses:
            rows = codec.encode_commands(
                bus.commands, 0, bus.members, self._node_ids, self._controlword, self._counts
            )
            bus.socket.send(bus.commands, rows)

    def all_enabled(self) -> bool:
        """Return whether every drive says that its operation is enabled."""
        return self.first_not_enabled() < 0

    def first_not_enabled(self) -> int:
        """Return the index of the first drive that is not enabled, -1 when all are."""
        for i, status in enumerate(self.status.tolist()):
            if states.state_of(status) != states.OPERATION_ENABLED:
                return i
        return -1

    def all_disabled(self) -> bool:
        """Return whether no drive says that it may still give torque."""
        return all(states.state_of(status) not in _LIVE for status in self.status.tolist())

    # -- receiving ----------------------------------------------------------------------

    def _take(self, bus: _Bus) -> int:
        """Receive and decode what waits on one bus; return how many frames."""
        count = bus.socket.receive(bus.inbox)
        if count:
            self._decode(bus, count)
        return count

    def _decode(self, bus: _Bus, count: int) -> None:
        marked = codec.decode_feedback(
            bus.inbox, count, bus.lookup, self._scale, self._values, self._words, bus.other
        )
        if marked:
            self._report(bus, count)

    def _report(self, bus: _Bus, count: int) -> None:
        """Pass emergencies on; SDO answers and strangers' frames are not the loop's affair."""
        for row in range(count):
            if bus.other[row] == 2:
                can_id, data = unpack(bus.inbox[row].tobytes())
                code, register, _ = codec.decode_emcy(data)
                node = can_id & 0x7F
                self._event(
                    bus.socket.name,
                    f"emergency 0x{code:04X}, register 0x{register:02X}, node {node}",
                )

    def _until_barrier(self, bus: _Bus) -> None:
        while True:
            count = bus.socket.receive(bus.inbox)
            at = find_barrier(bus.inbox, count)
            if at:
                self._decode(bus, at)
            if at < count:
                return
            if not count:
                if bus.socket.fd < 0:
                    raise BusError(bus.socket.name, "the rig did not end its share of the cycle")
                Waiter([bus.socket.fd]).wait(_LOCKSTEP_PATIENCE_S)

    def _until_answered(self, latest: int) -> None:
        words = self._words
        while True:
            for bus in self._buses:
                self._take(bus)
            if not _missing(words):
                return
            left = latest - self._clock.now()
            if left <= 0:
                return
            self._waiter.wait(left * 1e-9)
