"""All emulated CiA 402 drives of the rig, on all its buses.

Per service the rig calls, in rig time and from its own loop:

    drives.tick(t)
    for every bus, for every frame that came:
        row = drives.receive(bus, frames, row, count)    # up to and including a SYNC
        ... the plant moves on to t and writes POSITION, VELOCITY, TORQUE_ACTUAL ...
        count = drives.answer(bus, out)                  # TPDOs, EMCY, SDO, heartbeats

PDOs and the state machine are kernels; NMT, SDO, heartbeats and emergencies are canopen's
LocalNode without its threads.

Source: CiA 301, CiA 402-2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames
from dftc_rt.drives.cia402 import objects as od
from dftc_rt.drives.cia402 import states
from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import InputError
from hil.drive import service, slots
from hil.drive.object_dictionary import DriveNode
from hil.drive.silent_network import NEVER, SilentNetwork

_HISTORY: Final = 8
_CLASS_BITS: Final = {0x2: 1, 0x3: 2, 0x4: 3, 0x8: 4}  # error register, by the code's class
_NMT_COMMANDS: Final = (
    od.NMT_START,
    od.NMT_STOP,
    od.NMT_PRE_OPERATIONAL,
    od.NMT_RESET_NODE,
    od.NMT_RESET_COMMUNICATION,
)


@dataclass(frozen=True, slots=True)
class DriveSpec:
    """One emulated drive.

    Attributes:
        node_id: Node id, 1 to 126.
        bus: Index of its bus.
        scale: Its data sheet.
        watchdog_s: Longest time between RPDOs while enabled, s of rig time; 0: none.
            Object 1400h:05h, when written, takes its place.
    """

    node_id: int
    bus: int
    scale: JointScale
    watchdog_s: float = 0.0


class Cia402Drives:
    """The drives of a rig.

    Attributes:
        objects: What the drives know, (n, N_OBJECTS), int64, columns of
            :mod:`hil.drive.slots`; the plant writes POSITION, VELOCITY, TORQUE_ACTUAL.
        pdo: PDO parameters, (n, 8, N_PDO), int64.
        synced: Whether the last :meth:`receive` ended at a SYNC.
        command: View of ``objects``: torque to follow, (n,), per mille of rated.
        operation_enabled: View: 1 while operation is enabled, (n,).
        state: View: CiA 402 state, (n,).
        commands: View: target torques actuated so far, (n,).
    """

    def __init__(self, specs: Sequence[DriveSpec], buses: int) -> None:
        """Power on: boot-up messages wait in the first answer of each bus.

        Args:
            specs: The drives, in joint order.
            buses: Number of buses.

        Raises:
            InputError: A node id or a bus is out of range or taken.
        """
        n = len(specs)
        self.objects: NDArray[np.int64] = np.zeros((n, slots.N_OBJECTS), dtype=np.int64)
        self.pdo: NDArray[np.int64] = np.zeros((n, 8, slots.N_PDO), dtype=np.int64)
        self.specs = tuple(specs)
        self.synced = False
        self.command = self.objects[:, slots.COMMAND]
        self.operation_enabled = self.objects[:, slots.ENABLED]
        self.state = self.objects[:, slots.STATE]
        self.commands = self.objects[:, slots.COMMANDS]
        self._networks = [SilentNetwork() for _ in range(buses)]
        self._sync = [-1] * buses
        self._now = 0
        self._deadline = NEVER
        self._heard = [-1] * n  # when the consumed heartbeat last came, µs
        self._members = _members(self.specs, buses)
        self._lookups = [np.full(2048, -1, dtype=np.int32) for _ in range(buses)]
        self._wired = False
        self._nodes: list[DriveNode] = []
        for d, spec in enumerate(specs):
            node = DriveNode(spec.node_id, spec.scale, self.objects[d], self.pdo[d], self._rewire)
            self._networks[spec.bus][spec.node_id] = node
            self._nodes.append(node)
        self._wired = True
        for d in range(n):
            self._boot(d, od.NMT_RESET_NODE)
        service.proceed(self.objects, 0)  # compile now

    # --- once per service ------------------------------------------------------------

    def tick(self, t: float) -> None:
        """Let rig time move on: timers, watchdogs, steps that drives take by themselves.

        Args:
            t: Rig time, s; never less than before.
        """
        now = round(t * 1e6)
        self._now = now
        if service.proceed(self.objects, now):
            self._timed_out()
        if now >= self._deadline:
            self._serve_timers()

    def receive(self, bus: int, frames: Frames, start: int, count: int) -> int:
        """Take frames of one bus up to and including the next SYNC.

        RPDOs that waited for that SYNC are in force on return (``synced`` is True then).

        Args:
            bus: Index of the bus.
            frames: Batch, (capacity, 16), rows in the order they came.
            start: First row to take.
            count: Rows filled.

        Returns:
            Row after the last one taken: ``count`` unless a SYNC came first.
        """
        self.synced = False
        while True:
            code: int = service.receive(
                frames,
                start,
                count,
                self._lookups[bus],
                self._members[bus],
                self.objects,
                self.pdo,
                self._now,
            )
            start, why = code >> 2, code & 3
            if why == service.AT_MANAGED:
                self._managed(bus, frames[start - 1])
                continue
            if why == service.AT_SYNC:
                row = frames[start - 1]
                self._sync[bus] = int(row[8]) if row[4] else 0
                self.synced = True
            return start

    def answer(self, bus: int, out: Frames) -> int:
        """Fill in what the drives of one bus send now; return how many rows.

        Args:
            bus: Index of the bus.
            out: Batch to fill from row 0, (capacity, 16).
        """
        code: int = service.answer(
            out, self._members[bus], self.objects, self.pdo, self._sync[bus], self._now
        )
        self._sync[bus] = -1
        rows = code & 0xFFFF
        if code >> 16:
            self._pending_emergencies(bus)
        outbox = self._networks[bus].outbox
        if outbox:
            taken = min(len(outbox), out.shape[0] - rows)
            for raw in outbox[:taken]:
                out[rows] = np.frombuffer(raw, dtype=np.uint8)
                rows += 1
            del outbox[:taken]
        return rows

    # --- what the rig may ask or do --------------------------------------------------

    def enabled(self, drive: int) -> bool:
        """Whether a drive's operation is enabled."""
        return bool(self.objects[drive, slots.ENABLED])

    def fault(self, drive: int, error_code: int, lasting: bool = False) -> None:
        """Put a drive into fault, as it would do for a cause of its own.

        Args:
            drive: Drive.
            error_code: EMCY error code, also in 603Fh (CiA 402-2 lists them).
            lasting: The cause stays until :meth:`clear_cause`; resets are refused.
        """
        row = self.objects[drive]
        row[slots.FAULT_PRESENT] = 1 if lasting else row[slots.FAULT_PRESENT]
        row[slots.ERROR_CODE] = error_code
        row[slots.ERROR_REGISTER] |= 1 | 1 << _CLASS_BITS.get(error_code >> 12, 0)
        if row[slots.STATE] not in (states.FAULT, states.FAULT_REACTION_ACTIVE):
            row[slots.STATE] = states.FAULT_REACTION_ACTIVE
        service.refresh(self.objects, drive)
        self._emergency(drive, error_code)

    def clear_cause(self, drive: int) -> None:
        """End a lasting cause of a fault; the fault itself waits for its reset."""
        self.objects[drive, slots.FAULT_PRESENT] = 0

    # --- NMT, SDO, heartbeats --------------------------------------------------------

    def _managed(self, bus: int, row: NDArray[np.uint8]) -> None:
        """Handle one frame that is no PDO."""
        can_id = int(row[0]) | int(row[1]) << 8
        data = bytearray(row[8 : 8 + row[4]])
        if can_id == od.NMT:
            if len(data) >= 2 and data[0] in _NMT_COMMANDS:
                for d in self._members[bus]:
                    if data[1] in (0, self._nodes[d].id):
                        self._command(int(d), data[0])
        elif can_id >= od.HEARTBEAT:
            for d in self._members[bus]:
                if self._nodes[d].consumer[0] == can_id - od.HEARTBEAT:
                    self._heard[d] = self._now
            self._plan()
        elif len(data) == 8:
            drive = next(d for d in self._members[bus] if self._nodes[d].id == can_id & 0x7F)
            if self.objects[drive, slots.NMT] != od.STOPPED:
                self._networks[bus].notify(can_id, data, self._now * 1e-6)
                self._plan()

    def _command(self, d: int, command: int) -> None:
        """Obey an NMT command."""
        node, spec = self._nodes[d], self.specs[d]
        if command in (od.NMT_RESET_NODE, od.NMT_RESET_COMMUNICATION):
            self._boot(d, command)
            return
        node.nmt.on_command(od.NMT, bytes([command, spec.node_id]), self._now * 1e-6)
        state = {od.NMT_START: od.OPERATIONAL, od.NMT_STOP: od.STOPPED}.get(
            command, od.PRE_OPERATIONAL
        )
        if state == od.OPERATIONAL and self.objects[d, slots.NMT] != od.OPERATIONAL:
            self.objects[d, slots.RPDO_TIME] = -1
            for number in range(8):
                node.restart_pdo(number)
        self.objects[d, slots.NMT] = state

    def _boot(self, d: int, command: int) -> None:
        """Reset a node (all of it, or its communication) and announce it."""
        node, spec, row = self._nodes[d], self.specs[d], self.objects[d]
        node.nmt.on_command(od.NMT, bytes([command, spec.node_id]), self._now * 1e-6)
        if command == od.NMT_RESET_NODE:
            kept = row[[slots.POSITION, slots.VELOCITY, slots.FAULT_PRESENT]].copy()
            row[:] = 0
            row[[slots.POSITION, slots.VELOCITY, slots.FAULT_PRESENT]] = kept
            node.load_defaults(everything=True)
            row[slots.STATE] = states.SWITCH_ON_DISABLED  # transitions 0 and 1
            for key, (slot, _, _) in slots.LIVE.items():
                variable = node.object_dictionary.get_variable(*key)
                if variable is not None and variable.writable and variable.default is not None:
                    row[slot] = variable.default
            row[slots.STANDSTILL] = spec.scale.counts_per_rev * spec.scale.gear // 200
        else:
            node.load_defaults(everything=False)
        row[slots.NMT] = od.PRE_OPERATIONAL
        row[slots.RPDO_TIME] = -1
        self._heard[d] = -1
        service.refresh(self.objects, d)
        node.nmt.state = "INITIALISING"  # sends the boot-up message
        node.nmt.state = "PRE-OPERATIONAL"
        self._rewire()

    def _rewire(self) -> None:
        """Rebuild what every bus listens to, watchdogs included."""
        if not self._wired:
            return
        for bus, members in enumerate(self._members):
            lookup = self._lookups[bus]
            lookup[:] = service.IGNORE
            for d in members[::-1]:
                for p in range(4):
                    row = self.pdo[d, p]
                    row[slots.NEXT] = -1
                    if row[slots.VALID]:
                        row[slots.NEXT] = lookup[row[slots.COB_ID]]
                        lookup[row[slots.COB_ID]] = d * 4 + p
            for d in members:
                lookup[od.SDO_REQUEST + self._nodes[d].id] = service.MANAGED
                if self._nodes[d].consumer[0]:
                    lookup[od.HEARTBEAT + self._nodes[d].consumer[0]] = service.MANAGED
            lookup[od.NMT] = service.MANAGED
            lookup[od.SYNC] = service.SYNC
        for d, spec in enumerate(self.specs):
            timers = self.pdo[d, :4, slots.EVENT_TIMER][self.pdo[d, :4, slots.VALID] == 1]
            timers = timers[timers > 0]
            self.objects[d, slots.WATCHDOG] = (
                timers.min() if timers.size else round(spec.watchdog_s * 1e6)
            )
        self._plan()

    def _plan(self) -> None:
        """Find the next moment at which a timer of any drive matters."""
        deadline = NEVER
        for network in self._networks:
            network.now_us = self._now
            deadline = min(deadline, network.deadline_us)
        for d, node in enumerate(self._nodes):
            if node.consumer[1] and self._heard[d] >= 0:
                deadline = min(deadline, self._heard[d] + node.consumer[1] + 1)
        self._deadline = deadline

    def _serve_timers(self) -> None:
        """Send heartbeats that are due; react to those that did not come."""
        for network in self._networks:
            network.now_us = self._now
            if self._now >= network.deadline_us:
                network.serve_timers()
        for d, node in enumerate(self._nodes):
            limit = node.consumer[1]
            if limit and 0 <= self._heard[d] < self._now - limit:
                self._heard[d] = -1  # heard again, it is watched again
                behaviour = node.value(od.ERROR_BEHAVIOUR, 1)
                if behaviour == 0 and self.objects[d, slots.NMT] == od.OPERATIONAL:
                    self._command(d, od.NMT_PRE_OPERATIONAL)
                elif behaviour == 2:
                    self._command(d, od.NMT_STOP)
                self._connection_lost(d, od.EMCY_HEARTBEAT_LOST)
        self._plan()

    # --- faults and emergencies ------------------------------------------------------

    def _timed_out(self) -> None:
        """React to drives that have had no RPDO for too long."""
        for d in np.flatnonzero(self.objects[:, slots.TIMED_OUT]):
            self.objects[d, slots.TIMED_OUT] = 0
            self.objects[d, slots.RPDO_TIME] = -1
            self._connection_lost(int(d), od.EMCY_RPDO_TIMEOUT)

    def _connection_lost(self, d: int, code: int) -> None:
        """Do what object 6007h says about a lost connection."""
        option = self.objects[d, slots.ABORT_OPTION]
        if option == od.ABORT_FAULT:
            self.fault(d, code)
            return
        self._emergency(d, code)
        if option in (2, 3):
            word = states.CW_DISABLE_VOLTAGE if option == 2 else states.CW_QUICK_STOP
            previous = int(self.objects[d, slots.CONTROLWORD])
            self.objects[d, slots.CONTROLWORD] = word
            service.control(self.objects, d, previous)
            service.refresh(self.objects, d)

    def _pending_emergencies(self, bus: int) -> None:
        """Send the emergencies that kernels have asked for."""
        for d in self._members[bus]:
            row = self.objects[d]
            if row[slots.RESET_PENDING]:
                row[slots.RESET_PENDING] = 0
                self._emergency(int(d), od.EMCY_RESET)
            if row[slots.LENGTH_ERROR]:
                row[slots.LENGTH_ERROR] = 0
                self._emergency(int(d), od.EMCY_PDO_LENGTH)

    def _emergency(self, d: int, code: int) -> None:
        """Send an emergency and remember it in object 1003h."""
        node = self._nodes[d]
        if code != od.EMCY_RESET:
            node.error_history.insert(0, code)
            del node.error_history[_HISTORY:]
        if self.objects[d, slots.NMT] in (od.OPERATIONAL, od.PRE_OPERATIONAL):
            register = int(self.objects[d, slots.ERROR_REGISTER])
            node.emcy.send(code, register)


def _members(specs: Sequence[DriveSpec], buses: int) -> list[NDArray[np.int64]]:
    """Return the drives of each bus in the order of their node ids.

    Raises:
        InputError: A node id or a bus is out of range or taken.
    """
    taken: set[tuple[int, int]] = set()
    for spec in specs:
        where = f"drive of {spec.scale.joint}"
        if not 1 <= spec.node_id <= 126:
            raise InputError(where, f"node id {spec.node_id}", "1 to 126")
        if not 0 <= spec.bus < buses:
            raise InputError(where, f"bus {spec.bus}", f"0 to {buses - 1}")
        if (spec.bus, spec.node_id) in taken:
            raise InputError(where, f"node id {spec.node_id} is taken on bus {spec.bus}")
        taken.add((spec.bus, spec.node_id))
    order = sorted(range(len(specs)), key=lambda d: specs[d].node_id)
    return [
        np.array([d for d in order if specs[d].bus == bus], dtype=np.int64) for bus in range(buses)
    ]
