"""All emulated moteus drives of the rig, on all its buses.

Used as :class:`hil.drive.node402.Cia402Drives` is. There is no SYNC: the first torque command,
or question alone, of a cycle takes its place.

A drive in position mode without a command for longer than its watchdog goes into the mode
"timeout": torque off, brake closed, until it is told to stop.

Source: [moteus].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import FD_FRAME_SIZE, Frames, frame_buffer
from dftc_rt.drives.moteus import registers as reg
from dftc_rt.drives.moteus.scale import MoteusScale
from dftc_rt.drives.scale import MAX_COUNTS, RAD_PER_COUNT, ScaleTable
from dftc_rt.errors import InputError
from hil.drive import moteus_registers as columns
from hil.drive import moteus_service as service
from hil.drive import slots
from hil.drive.spec import DriveSpec, members_of

_CAPACITY: Final = 512  # rows of the largest answer


class MoteusDrives:
    """The drives of a rig.

    Attributes:
        objects: What the drives know, (n, N_OBJECTS), int64, columns of
            :mod:`hil.drive.slots`; the plant writes POSITION, VELOCITY, TORQUE_ACTUAL.
            Torques are in 0.01 Nm.
        mode: Modes, (n,), as register 0x000 has them.
        synced: Whether the last :meth:`receive` took a torque command or a question.
        switched: Whether it took what stops a drive.
        command: View of ``objects``: torque to follow, (n,), 0.01 Nm.
        operation_enabled: View: 1 in position mode, (n,).
        commands: View: torque commands taken so far, (n,).
        senders: Drive of each row of the last answer, (512,), int32.
    """

    def __init__(self, specs: Sequence[DriveSpec], buses: int) -> None:
        """Power on: stopped, silent.

        Args:
            specs: The drives, in joint order; their scales are ``MoteusScale``.
            buses: Number of buses.

        Raises:
            InputError: A node id or a bus is out of range or taken, or a drive is of another
                profile.
        """
        n = len(specs)
        scales = [spec.scale for spec in specs if isinstance(spec.scale, MoteusScale)]
        if len(scales) < n:
            raise InputError("drives", "a drive of another profile", "moteus drives")
        members_of(specs, buses)
        self._lookups = [np.full(128, -1, dtype=np.int32) for _ in range(buses)]
        self._asked = [frame_buffer(_CAPACITY, FD_FRAME_SIZE) for _ in range(buses)]
        self._askers = [np.zeros(1 + _CAPACITY, dtype=np.int64) for _ in range(buses)]
        table = ScaleTable.of(scales).values
        self._turns = np.abs(table[RAD_PER_COUNT]) / (2.0 * np.pi)
        self.objects: NDArray[np.int64] = np.zeros((n, slots.N_OBJECTS), dtype=np.int64)
        self.objects[:, slots.MAX_TORQUE] = table[MAX_COUNTS]
        self._own = np.zeros((n, columns.OWN), dtype=np.int64)
        self._registers = np.full((n, reg.COMMANDS), np.nan)
        for d, spec in enumerate(specs):
            self._own[d, columns.NODE] = spec.node_id
            self._own[d, columns.DEFAULT_TIMEOUT] = round(spec.watchdog_s * 1e6)
            self._lookups[spec.bus][spec.node_id] = d
        self.mode = self._own[:, columns.MODE]
        self.command = self.objects[:, slots.COMMAND]
        self.operation_enabled = self.objects[:, slots.ENABLED]
        self.objects[:, slots.LETS_GO] = 1  # there is no other stop
        self.commands = self.objects[:, slots.COMMANDS]
        self.senders = np.zeros(_CAPACITY, dtype=np.int32)
        self.synced = self.switched = False
        self._now = 0
        nothing = frame_buffer(1, FD_FRAME_SIZE)
        self.tick(0.0)  # compile now
        for bus in range(buses):
            self.receive(bus, nothing, 0, 0)
            self.answer(bus, nothing)

    def tick(self, t: float) -> None:
        """Let rig time move on: the watchdogs run.

        Args:
            t: Rig time, s; never less than before.
        """
        self._now = round(t * 1e6)
        service.proceed(self.objects, self._own, self._now)

    def receive(self, bus: int, frames: Frames, start: int, count: int) -> int:
        """Take all frames of one bus; return ``count``.

        Args:
            bus: Index of the bus.
            frames: Batch, (capacity, 72), rows in the order they came.
            start: First row to take.
            count: Rows filled.
        """
        what: int = service.receive(
            frames, start, count, self._lookups[bus], self.objects, self._own, self._registers,
            self._turns, self._asked[bus], self._askers[bus], self._now,
        )  # fmt: skip
        self.synced = bool(what & service.SYNCED)
        self.switched = bool(what & service.SWITCHED)
        return count

    def answer(self, bus: int, out: Frames) -> int:
        """Fill in what the drives of one bus send now; return how many rows.

        Args:
            bus: Index of the bus.
            out: Batch to fill from row 0, (capacity, 72); ``senders`` says whose they are.
        """
        rows: int = service.answer(
            out, self.senders, self.objects, self._own, self._registers, self._turns,
            self._asked[bus], self._askers[bus],
        )  # fmt: skip
        return rows

    def fault(self, drive: int, code: int) -> None:
        """Put a drive into fault: no torque, until it is stopped and the cause is gone.

        Args:
            drive: Drive.
            code: Fault code, 32 to 48; 0: the cause is gone.
        """
        self.objects[drive, slots.FAULT_PRESENT] = int(code != 0)
        if code:
            self.objects[drive, slots.ERROR_CODE] = code
            self.objects[drive, [slots.ENABLED, slots.COMMAND]] = 0
            self.mode[drive] = reg.FAULTED
