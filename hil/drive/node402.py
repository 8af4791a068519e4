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
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames
from hil.drive import service, slots
from hil.drive.late import LateAnswers
from hil.drive.management import NodeManagement
from hil.drive.spec import DriveSpec

__all__ = ["Cia402Drives", "DriveSpec"]

_CAPACITY: Final = 512  # rows of the largest answer


class Cia402Drives:
    """The drives of a rig.

    Attributes:
        objects: What the drives know, (n, N_OBJECTS), int64, columns of
            :mod:`hil.drive.slots`; the plant writes POSITION, VELOCITY, TORQUE_ACTUAL.
        pdo: PDO parameters, (n, 8, N_PDO), int64.
        synced: Whether the last :meth:`receive` ended at a SYNC.
        switched: False: a controlword waits for SYNC too.
        command: View of ``objects``: torque to follow, (n,), per mille of rated.
        operation_enabled: View: 1 while operation is enabled, (n,).
        state: View: CiA 402 state, (n,).
        commands: View: target torques actuated so far, (n,).
        senders: Drive of each row of the last answer, (512,), int32.
    """

    def __init__(self, specs: Sequence[DriveSpec], buses: int) -> None:
        """Power on: boot-up messages wait in the first answer of each bus.

        Args:
            specs: The drives, in joint order.
            buses: Number of buses.

        Raises:
            InputError: A node id or a bus is out of range or taken.
        """
        self._nodes = NodeManagement(specs, buses)
        self.specs = self._nodes.specs
        self.objects: NDArray[np.int64] = self._nodes.objects
        self.pdo: NDArray[np.int64] = self._nodes.pdo
        self.command = self.objects[:, slots.COMMAND]
        self.operation_enabled = self.objects[:, slots.ENABLED]
        self.state = self.objects[:, slots.STATE]
        self.commands = self.objects[:, slots.COMMANDS]
        self.synced = self.switched = False
        self._late = LateAnswers(len(specs))
        self._sync = [-1] * buses  # counter of a SYNC that is to be answered
        self.senders = np.zeros(_CAPACITY, dtype=np.int32)
        nothing = np.zeros((1, 16), dtype=np.uint8)
        self.tick(0.0)  # compile now
        for bus in range(buses):
            self.receive(bus, nothing, 0, 0)
            service.answer(
                nothing, self.senders, self._nodes.members[bus][:0], self.objects, self.pdo, -1, 0
            )

    # --- once per service ------------------------------------------------------------

    def tick(self, t: float) -> None:
        """Let rig time move on: timers, watchdogs, steps that drives take by themselves.

        Args:
            t: Rig time, s; never less than before.
        """
        now = round(t * 1e6)
        self._nodes.now_us = now
        if service.proceed(self.objects, now):
            self._nodes.timed_out()
        if now >= self._nodes.deadline_us:
            self._nodes.serve_timers()

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
        nodes = self._nodes
        self.synced = False
        while True:
            code: int = service.receive(
                frames,
                start,
                count,
                nodes.lookups[bus],
                nodes.members[bus],
                self.objects,
                self.pdo,
                nodes.now_us,
            )
            start, why = code >> 2, code & 3
            if why == service.AT_MANAGED:
                nodes.managed(bus, frames[start - 1])
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
            out: Batch to fill from row 0, (capacity, 16); ``senders`` says whose they are.
        """
        nodes = self._nodes
        code: int = service.answer(
            out,
            self.senders,
            nodes.members[bus],
            self.objects,
            self.pdo,
            self._sync[bus],
            nodes.now_us,
        )
        self._sync[bus] = -1
        rows = code & 0xFFFF
        if code >> 16:
            nodes.pending_emergencies(bus)
        outbox = nodes.networks[bus].outbox
        if outbox:
            taken = min(len(outbox), out.shape[0] - rows)
            for raw in outbox[:taken]:
                sender = nodes.sender(bus, raw)
                if not self.objects[sender, slots.OFF_BUS]:
                    out[rows] = np.frombuffer(raw, dtype=np.uint8)
                    self.senders[rows] = sender
                    rows += 1
            del outbox[:taken]
        if self._late.any:
            rows = self._late.pass_on(bus, nodes.now_us, out, rows, self.senders)
        return rows

    # --- what the rig may ask or do --------------------------------------------------

    def enabled(self, drive: int) -> bool:
        """Whether a drive's operation is enabled."""
        return bool(self.objects[drive, slots.ENABLED])

    def fault(self, drive: int, error_code: int, lasting: bool = False) -> None:
        """Put a drive into fault for a cause of its own: it lets go of its joint.

        Args:
            drive: Drive.
            error_code: EMCY error code, also in 603Fh (CiA 402-2 lists them).
            lasting: The cause stays until :meth:`clear_cause`; resets are refused.
        """
        self.objects[drive, slots.LETS_GO] = 1
        self._nodes.fault(drive, error_code, lasting)

    def clear_cause(self, drive: int) -> None:
        """End a lasting cause of a fault; the fault itself waits for its reset."""
        self.objects[drive, slots.FAULT_PRESENT] = 0

    def disconnect(self, drive: int, off_bus: bool) -> None:
        """Take a drive's node off its bus, or put it back; nothing that it missed comes again."""
        others = self.objects[drive, slots.OFF_BUS] & ~slots.DISCONNECTED
        self.objects[drive, slots.OFF_BUS] = others | (slots.DISCONNECTED if off_bus else 0)

    def delay(self, drive: int, delay_s: float) -> None:
        """Let what a drive sends come ``delay_s`` later; 0: at once again, behind what waits."""
        self._late.delay(drive, delay_s)

    def switch_off(self, drive: int) -> None:
        """Take a drive's supply away: its state is lost, its brake closes, it leaves the bus."""
        self._nodes.switch_off(drive)
        self.objects[drive, slots.LETS_GO] = 1

    def switch_on(self, drive: int) -> None:
        """Let a drive power on: its boot-up message follows."""
        self._nodes.switch_on(drive)
