"""NMT, SDO, heartbeats and emergencies of the emulated drives: all that is not cyclic.

canopen's LocalNodes answer SDO and produce heartbeats; what the drives do about NMT
commands, lost connections and faults is here. Time is the rig's.

Source: CiA 301 (NMT, heartbeat, EMCY, object 1029h), CiA 402-2 (objects 6007h, 603Fh).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.drives.cia402 import objects as od
from dftc_rt.drives.cia402 import states
from hil.drive import service, slots
from hil.drive.object_dictionary import DriveNode
from hil.drive.silent_network import NEVER, SilentNetwork
from hil.drive.spec import DriveSpec, members_of

I64 = NDArray[np.int64]

_HISTORY: Final = 8  # entries of object 1003h
_CLASS_BITS: Final = {0x2: 1, 0x3: 2, 0x4: 3, 0x8: 4}  # error register, by the code's class
_STATES: Final = {
    od.NMT_START: od.OPERATIONAL,
    od.NMT_STOP: od.STOPPED,
    od.NMT_PRE_OPERATIONAL: od.PRE_OPERATIONAL,
}
_RESETS: Final = (od.NMT_RESET_NODE, od.NMT_RESET_COMMUNICATION)


class NodeManagement:
    """The drives' slower half.

    Attributes:
        specs: The drives, in joint order.
        objects: (n, N_OBJECTS), columns of :mod:`hil.drive.slots`.
        pdo: (n, 8, N_PDO).
        members: Drives of each bus in the order of their node ids, (m,) each.
        lookups: What each bus listens to, (2048,) each (see :mod:`hil.drive.service`).
        networks: One per bus, with its outbox.
        now_us: Rig time, µs, set by the owner.
        deadline_us: When :meth:`serve_timers` is due next, µs.
    """

    def __init__(self, specs: Sequence[DriveSpec], buses: int) -> None:
        """Power on: boot-up messages wait in the outboxes.

        Raises:
            InputError: A node id or a bus is out of range or taken.
        """
        n = len(specs)
        self.specs = tuple(specs)
        self.members = members_of(self.specs, buses)
        self.objects: I64 = np.zeros((n, slots.N_OBJECTS), dtype=np.int64)
        self.pdo: I64 = np.zeros((n, 8, slots.N_PDO), dtype=np.int64)
        self.lookups = [np.full(2048, service.IGNORE, dtype=np.int32) for _ in range(buses)]
        self.networks = [SilentNetwork() for _ in range(buses)]
        self.now_us = 0
        self.deadline_us = NEVER
        self._nodes: list[DriveNode] = []
        self._powered = False
        for d, spec in enumerate(specs):
            node = DriveNode(spec.node_id, spec.scale, self.objects[d], self.pdo[d], self._rewire)
            self.networks[spec.bus][spec.node_id] = node
            self._nodes.append(node)
        for d in range(n):
            self._boot(d, od.NMT_RESET_NODE)
        self._powered = True
        self._rewire()

    def managed(self, bus: int, row: NDArray[np.uint8]) -> None:
        """Handle one frame that is no PDO."""
        can_id = int(row[0]) | int(row[1]) << 8
        data = bytearray(row[8 : 8 + row[4]])
        hearing = [d for d in self.members[bus] if not self.objects[d, slots.OFF_BUS]]
        if can_id == od.NMT:
            if len(data) >= 2 and data[0] in (*_STATES, *_RESETS):
                for d in hearing:
                    if data[1] in (0, self._nodes[d].id):
                        self._command(int(d), data[0])
        elif can_id >= od.HEARTBEAT:
            for d in hearing:
                if self._nodes[d].consumer[0] == can_id - od.HEARTBEAT:
                    self._nodes[d].heard_us = self.now_us
            self._plan()
        elif len(data) == 8:
            asked = (d for d in hearing if self._nodes[d].id == can_id & 0x7F)
            if any(self.objects[d, slots.NMT] != od.STOPPED for d in asked):
                self.networks[bus].now_us = self.now_us
                self.networks[bus].notify(can_id, data, self.now_us * 1e-6)
                self._plan()

    def sender(self, bus: int, raw: bytes) -> int:
        """Return whose frame it is, of a bus's outbox: those identifiers end in the node's."""
        node_id = raw[0] & 0x7F
        return next(int(d) for d in self.members[bus] if self.specs[d].node_id == node_id)

    def _command(self, d: int, command: int) -> None:
        """Obey an NMT command."""
        live = self.objects[d, slots.STATE] == states.OPERATION_ENABLED
        if live and command in (od.NMT_STOP, od.NMT_RESET_COMMUNICATION):
            self._connection_lost(d, od.EMCY_COMMUNICATION)  # 6007h names both
        if command in _RESETS:
            self._boot(d, command)
        else:
            self._enter(d, command)

    def _enter(self, d: int, command: int) -> None:
        """Enter the NMT state that a command asks for."""
        self._tell_canopen(self._nodes[d], command)
        state = _STATES[command]
        if state == od.STOPPED:
            self._nodes[d].sdo.forget()
        if state == od.OPERATIONAL and self.objects[d, slots.NMT] != od.OPERATIONAL:
            self.objects[d, slots.RPDO_TIME] = -1
            for number in range(8):
                self._nodes[d].restart_pdo(number)
        self.objects[d, slots.NMT] = state

    def _tell_canopen(self, node: DriveNode, command: int) -> None:
        """Let canopen's own idea of the NMT state, which heartbeats carry, follow."""
        frame = bytes([command, 0])
        node.nmt.on_command(od.NMT, frame, self.now_us * 1e-6)  # type: ignore[no-untyped-call]

    def _boot(self, d: int, command: int) -> None:
        """Reset a node (all of it, or its communication) and announce it."""
        node, spec, row = self._nodes[d], self.specs[d], self.objects[d]
        self._tell_canopen(node, command)
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
        service.refresh(self.objects, d)
        node.nmt.state = "INITIALISING"  # sends the boot-up message
        node.nmt.state = "PRE-OPERATIONAL"
        self._rewire()

    def _rewire(self) -> None:
        """Rebuild what every bus listens to, watchdogs included."""
        if not self._powered:
            return
        for bus, members in enumerate(self.members):
            lookup = self.lookups[bus]
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
        for network in self.networks:
            network.now_us = self.now_us
            deadline = min(deadline, network.deadline_us)
        for node in self._nodes:
            if node.consumer[1] and node.heard_us >= 0:
                deadline = min(deadline, node.heard_us + node.consumer[1] + 1)
            deadline = min(deadline, node.sdo.due_us)
        self.deadline_us = deadline

    def serve_timers(self) -> None:
        """Send heartbeats that are due; react to those that did not come."""
        for network in self.networks:
            network.now_us = self.now_us
            if self.now_us >= network.deadline_us:
                network.serve_timers()
        for d, node in enumerate(self._nodes):
            limit = node.consumer[1]
            if limit and 0 <= node.heard_us < self.now_us - limit:
                node.heard_us = -1  # heard again, it is watched again
                self._connection_lost(d, od.EMCY_HEARTBEAT_LOST)
                behaviour = node.value(od.ERROR_BEHAVIOUR, 1)
                if behaviour == 0 and self.objects[d, slots.NMT] == od.OPERATIONAL:
                    self._enter(d, od.NMT_PRE_OPERATIONAL)
                elif behaviour == 2:
                    self._enter(d, od.NMT_STOP)
            if self.now_us >= node.sdo.due_us:
                node.sdo.time_out()
        self._plan()

    def switch_off(self, drive: int) -> None:
        """Take a drive's supply away: its state is lost, its brake closes, it leaves the bus."""
        self._boot(drive, od.NMT_RESET_NODE)
        self.objects[drive, slots.OFF_BUS] |= slots.DISCONNECTED

    def switch_on(self, drive: int) -> None:
        """Let a drive power on: its boot-up message follows."""
        self._boot(drive, od.NMT_RESET_NODE)

    # --- faults and emergencies ------------------------------------------------------

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

    def timed_out(self) -> None:
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

    def pending_emergencies(self, bus: int) -> None:
        """Send the emergencies that kernels have asked for."""
        for d in self.members[bus]:
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
