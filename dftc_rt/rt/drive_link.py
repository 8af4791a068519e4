"""The executor's view of the drives: one exchange of frames a cycle, over several buses."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.barrier import find_barrier
from dftc_rt.bus.error_frames import ErrorCounts, bus_off_remedy
from dftc_rt.bus.frame import BARRIER_ID, ERR_FLAG, FRAME_SIZE, Frames, frame_buffer, unpack
from dftc_rt.bus.interface import FrameSocket, device_of
from dftc_rt.bus.wait import Waiter
from dftc_rt.drives.cia402 import codec, states
from dftc_rt.drives.interface import GOAL_STOP, DriveCycle, SetUp
from dftc_rt.errors import BusError
from dftc_rt.rt.clock import NS, Clock

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_CAPACITY: Final = 256
_BARRIER: Final = BARRIER_ID | 8 << 32  # identifier and length, as one word of a frame
_ERROR: Final = ERR_FLAG >> 24  # in the last byte of an identifier
_LOCKSTEP_PATIENCE_S: Final = 1.0  # between looks; a rig that dies closes the bus
_LIVE: Final = (
    states.OPERATION_ENABLED,
    states.QUICK_STOP_ACTIVE,
    states.FAULT_REACTION_ACTIVE,
)


@numba.njit(cache=True)
def _age(seen: I64, age: F64) -> int:
    """Age what was not answered; return how many joints that is."""
    missing = 0
    for i in range(seen.shape[0]):
        if seen[i] & 1:
            age[i] = 0.0
        else:
            age[i] += 1.0
            missing += 1
    return missing


@numba.njit(cache=True)
def _late(seen: I64, age: F64) -> None:
    """Count answers that came after the last cycle's read budget as what they are: its own."""
    for i in range(seen.shape[0]):
        if seen[i] & 1:
            age[i] = 0.0


@numba.njit(cache=True)
def _check(tau: F64, limit: F64, out: F64) -> int:
    """Copy torques that may go on the wire; return how many may not.

    One that is no finite number becomes zero, one out of range the joint's limit.
    """
    altered = 0
    for i in range(tau.shape[0]):
        wanted = tau[i] if np.isfinite(tau[i]) else 0.0
        out[i] = min(max(wanted, -limit[i]), limit[i])
        if out[i] != tau[i]:
            altered += 1
    return altered


class DriveLink:
    """Exchanges SYNC, feedback and commands with the drives of a robot.

    Attributes:
        q: Measured position, (n,), rad.
        v: Measured velocity, (n,), rad/s.
        age: Age of the measurement, (n,), cycles; 0 when it came this cycle.
        status: CiA 402 statusword, (n,).
        emergency: Last emergency error code, (n,); 0: none, or its cause is gone.
        sent: Torque as sent, after limiting and quantisation, (n,), Nm.
        missed: Answers that did not come in time, over all joints and cycles.
        refused: Frames that a bus did not take, over all buses and cycles.
        errors: Error frames of each bus.
        fault: What is wrong with a bus, so that the run has to end; "" while nothing is.
        altered: Torques that were no finite number or out of range, over all joints and cycles.
    """

    def __init__(
        self,
        sockets: Sequence[FrameSocket],
        cycle: DriveCycle,
        clock: Clock,
        read_budget_s: float,
        event: Callable[[str, str], object],
        frame_size: int = FRAME_SIZE,
        patience: int = 20,
        torque_limit: F64 | float = np.inf,
    ) -> None:
        """Prepare buffers.

        Args:
            sockets: One a bus.
            cycle: The profile's cyclic half.
            clock: Decides how the exchange waits: for a barrier in lock-step, for the
                read budget otherwise.
            read_budget_s: Longest wait for answers from the tick on, s.
            event: Called as (source, text) for what a drive says besides its answers.
            frame_size: Bytes of a row of every buffer: 16, or 72 where frames are CAN FD.
            patience: Cycles in a row in which a bus may take not all frames.
            torque_limit: Largest torque that goes on the wire, scalar or (n,), Nm; what the
                drives can be told (``max_torque_nm``) limits it in any case.
        """
        self._sockets = list(sockets)
        self._cycle = cycle
        self._clock = clock
        self._lockstep = clock.lockstep
        self._event = event
        self._budget_ns = round(read_budget_s * NS)
        self._buses: Sequence[int] = range(len(self._sockets))  # those that are still there
        self._patience = patience
        self._clogged = [0] * len(self._sockets)  # cycles in a row
        self._refused_by: set[int] = set()  # in this cycle
        self._lost: BusError | None = None
        self.errors = [ErrorCounts() for _ in self._sockets]
        self.fault = ""
        self.q, self.v = cycle.q, cycle.v
        self.status = cycle.status
        self.emergency = cycle.emergency
        self.sent = cycle.sent
        self.age = np.zeros(self.q.shape[0])
        self._zero = np.zeros(self.q.shape[0])
        self._torque = np.zeros(self.q.shape[0])
        self._torque_limit = np.broadcast_to(torque_limit, self.q.shape).astype(np.float64)
        self.missed = 0
        self.refused = 0
        self.altered = 0
        self._out = frame_buffer(_CAPACITY, frame_size)
        self._outs = [frame_buffer(_CAPACITY, frame_size) for _ in self._sockets]  # in lock-step
        self._words = [out.view("<u8") for out in self._outs]
        self._waiting = False  # in lock-step, commands that wait for the next SYNC
        self._inbox = frame_buffer(_CAPACITY, frame_size)
        self._inbox_words = self._inbox.view("<u8")
        self._waiter = Waiter([socket.fd for socket in sockets])
        self._waiters = [Waiter([socket.fd]) for socket in sockets]

    @property
    def goal(self) -> int:
        """What the drives are to do, one of ``dftc_rt.drives.interface.GOAL_*``."""
        return self._cycle.goal

    @goal.setter
    def goal(self, goal: int) -> None:
        self._cycle.goal = goal

    def start(self, found: SetUp) -> None:
        """Begin from what set-up found."""
        self._cycle.start(found)
        self.age[:] = 0.0

    def exchange(self, number: int, deadline: int) -> None:
        """Send SYNC on every bus and collect the answers. Real-time safe.

        Args:
            number: Number of this cycle, from 0.
            deadline: The tick, ns; the read budget counts from it, or from now if later.

        A bus that goes away is a ``fault``; the others go on, so that their drives can be
        stopped.

        Raises:
            BusError: The last bus has gone away; in lock-step, any.
        """
        cycle, out = self._cycle, self._out
        if self._refused_by or any(self._clogged):
            self._look_for_clogs()
        if self._lockstep:
            self._exchange_lockstep(number)
        else:
            if self._waiter.wait(0.0):  # an answer to an earlier tick is never new
                for bus in self._buses:
                    self._take(bus)
                _late(cycle.seen, self.age)
            cycle.begin()
            for bus in self._buses:
                self._send(bus, out, cycle.sync(bus, out))
            self._until_answered(max(deadline, self._clock.now()) + self._budget_ns)
        self.missed += _age(cycle.seen, self.age)

    def _exchange_lockstep(self, number: int) -> None:
        """Send the last cycle's commands, SYNC and the barrier in one go; no time is between."""
        cycle = self._cycle
        rows = [cycle.encode(bus, self._outs[bus]) if self._waiting else 0 for bus in self._buses]
        self._waiting = False
        cycle.begin()
        for bus in self._buses:
            row = cycle.sync(bus, self._outs[bus], rows[bus])
            self._words[bus][row, :2] = _BARRIER, number
            self._send(bus, self._outs[bus], row + 1)
        for bus in self._buses:
            self._until_barrier(bus, number)

    def command(self, tau: F64, torque: bool = True) -> None:
        """Send torque and controlword to every drive. Real-time safe.

        This is the last place before the wire, and checks every torque once more.

        In lock-step they wait here for the next SYNC: nothing happens before it.

        Args:
            tau: Torque, (n,), Nm.
            torque: False sends zero torque.

        Raises:
            BusError: The last bus has gone away.
        """
        cycle, out = self._cycle, self._out
        self.altered += _check(tau if torque else self._zero, self._torque_limit, self._torque)
        cycle.command(self._torque)
        if self._lockstep:
            self._waiting = True
            return
        for bus in self._buses:
            self._send(bus, out, cycle.encode(bus, out))

    def abandon(self) -> None:
        """Tell every drive that can still be reached to stop, as the last thing to be said."""
        cycle, out = self._cycle, self._out
        cycle.goal = GOAL_STOP
        cycle.command(self._zero)
        for bus in range(len(self._sockets)):
            with contextlib.suppress(BusError):
                self._sockets[bus].send(out, cycle.encode(bus, out))
                self._sockets[bus].send(out, cycle.sync(bus, out))

    def _send(self, bus: int, out: Frames, rows: int) -> None:
        """Send the first rows on one bus; what it refuses is dropped: the next cycle's are newer.

        Raises:
            BusError: The last bus has gone away.
        """
        try:
            sent = self._sockets[bus].send(out, rows)
        except BusError as error:
            self._lose(bus, error)
            return
        if sent < rows:
            if not self.refused:
                self._event(self._sockets[bus].name, f"takes no more frames; {self._clog(bus)}")
            self.refused += rows - sent
            self._refused_by.add(bus)

    def _look_for_clogs(self) -> None:
        """Count the cycles in a row in which a bus did not take all frames."""
        for bus in self._buses:
            self._clogged[bus] = self._clogged[bus] + 1 if bus in self._refused_by else 0
            if self._clogged[bus] >= self._patience and not self.fault:
                name = self._sockets[bus].name
                self.fault = f"{name}: no room for frames in {self._patience} cycles in a row; " + (
                    self._clog(bus)
                )
        self._refused_by.clear()

    def _clog(self, bus: int) -> str:
        """Return why a bus takes no frames, and what to do."""
        socket = self._sockets[bus]
        interface = device_of(socket)
        if not hasattr(socket, "interface"):
            return "nobody there takes them"
        return (
            f"does nobody acknowledge them? else ip link set {interface} txqueuelen 1000 makes room"
        )

    def _lose(self, bus: int, error: BusError) -> None:
        """Go on without a bus.

        Raises:
            BusError: It was the last one; says which was the first.
        """
        if self._lost is None:
            self._lost = error
            self.fault = self.fault or f"bus lost: {error}"
        self._buses = [each for each in self._buses if each != bus]
        if not self._buses or self._lockstep:
            raise self._lost
        self._waiter = Waiter([self._sockets[each].fd for each in self._buses])

    def all_enabled(self) -> bool:
        """Return whether every drive says that its operation is enabled."""
        return self.first_not_enabled() < 0

    def first_not_enabled(self) -> int:
        """Return the index of the first drive that is not enabled, -1 when all are."""
        for i, status in enumerate(self.status.tolist()):
            if states.state_of(status) != states.OPERATION_ENABLED:
                return i
        return -1

    def first_live(self) -> int:
        """Return the index of the first drive that may still give torque, -1 for none."""
        for i, status in enumerate(self.status.tolist()):
            if states.state_of(status) in _LIVE:
                return i
        return -1

    # -- receiving ----------------------------------------------------------------------

    def _take(self, bus: int) -> int:
        """Receive and decode what waits on one bus; return how many frames.

        Raises:
            BusError: The last bus has gone away.
        """
        try:
            count = self._sockets[bus].receive(self._inbox)
        except BusError as error:
            self._lose(bus, error)
            return 0
        if count and self._cycle.decode(bus, self._inbox, count):
            self._report(bus, self._inbox, count)
        return count

    def _report(self, bus: int, frames: Frames, count: int) -> None:
        """Pass emergencies and errors on; other nodes' frames are not the loop's affair."""
        for row in range(count):
            if self._cycle.other[row] == 1 and frames[row, 3] & _ERROR:
                self._note(bus, *unpack(frames[row, :FRAME_SIZE]))
            elif self._cycle.other[row] == 2:
                can_id, data = unpack(frames[row].tobytes())
                code, register, _ = codec.decode_emcy(data)
                self._event(
                    self._sockets[bus].name,
                    f"emergency 0x{code:04X}, register 0x{register:02X}, node {can_id & 0x7F}",
                )

    def _note(self, bus: int, can_id: int, data: bytes) -> None:
        """Take an error frame of an interface into account."""
        socket, errors = self._sockets[bus], self.errors[bus]
        for text in errors.take(can_id, data):
            self._event(socket.name, text)
        if errors.state == "bus-off" and not self.fault:
            self.fault = f"{socket.name}: {bus_off_remedy(device_of(socket))}"

    def _until_barrier(self, bus: int, number: int) -> None:
        """Receive on one bus until the rig has ended its share of the cycle."""
        socket, inbox = self._sockets[bus], self._inbox
        while True:
            count = socket.receive(inbox)
            at = find_barrier(inbox, count)
            if at and self._cycle.decode(bus, inbox, at):
                self._report(bus, inbox, at)
            if at < count:
                if self._inbox_words[at, 1] != number:
                    found = int(self._inbox_words[at, 1])
                    raise BusError(socket.name, f"barrier of cycle {found} instead of {number}")
                return
            if not count:
                if socket.fd < 0:
                    raise BusError(socket.name, "the rig did not end its share of the cycle")
                self._waiters[bus].wait(_LOCKSTEP_PATIENCE_S)

    def _until_answered(self, latest: int) -> None:
        """Receive until every joint has answered or the read budget ends."""
        cycle = self._cycle
        self._waiter.wait(max(latest - self._clock.now(), 0) * 1e-9)
        while True:
            waiter, missing = self._waiter, 0  # a bus that is lost leaves another waiter behind
            for at, bus in enumerate(self._buses):
                if waiter.ready(at):
                    self._take(bus)
                missing += cycle.missing(bus)
            if not missing:
                return
            left = latest - self._clock.now()
            if left <= 0:
                return
            self._waiter.wait(left * 1e-9)
