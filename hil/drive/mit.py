"""All emulated MIT drives of the rig, on all its buses.

Used as :class:`hil.drive.node402.Cia402Drives` is. There is no SYNC: the first command of a
cycle takes its place, and a command is in force as soon as it has been received.

A drive without a frame for longer than its watchdog leaves motor mode, torque off and brake
closed; it does not say so, as the protocol has no word for it.

Source: [katz2018].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.bus.frame import Frames, frame_buffer
from dftc_rt.drives.mit.scale import MitScale, wire_table
from dftc_rt.drives.scale import MAX_COUNTS, RAD_PER_COUNT, ScaleTable
from dftc_rt.errors import InputError
from hil.drive import mit_service as service
from hil.drive import slots
from hil.drive.spec import DriveSpec, members_of

_CAPACITY: Final = 512  # rows of the largest answer


class MitDrives:
    """The drives of a rig.

    Attributes:
        objects: What the drives know, (n, N_OBJECTS), int64, columns of
            :mod:`hil.drive.slots`; the plant writes POSITION, VELOCITY, TORQUE_ACTUAL.
            Torques are in half steps of ``MitScale``.
        synced: Whether the last :meth:`receive` took a command.
        switched: Whether it took a special frame.
        command: View of ``objects``: torque to follow, (n,), half steps.
        operation_enabled: View: 1 in motor mode, (n,).
        commands: View: commands taken so far, (n,).
        senders: Drive of each row of the last answer, (512,), int32.
    """

    def __init__(self, specs: Sequence[DriveSpec], buses: int) -> None:
        """Power on: out of motor mode, silent.

        Args:
            specs: The drives, in joint order; their scales are ``MitScale``.
            buses: Number of buses.

        Raises:
            InputError: A node id or a bus is out of range or taken, or a drive has no ranges.
        """
        n = len(specs)
        scales = [spec.scale for spec in specs if isinstance(spec.scale, MitScale)]
        if len(scales) < n:
            raise InputError("drives", "a drive without ranges", "MIT drives")
        self._members = members_of(specs, buses)
        self._lookups = [np.full(2048, -1, dtype=np.int32) for _ in range(buses)]
        table = ScaleTable.of(scales).values
        self._wire = wire_table(scales)
        self._radians = np.abs(table[RAD_PER_COUNT])
        self.objects: NDArray[np.int64] = np.zeros((n, slots.N_OBJECTS), dtype=np.int64)
        self.objects[:, slots.MAX_TORQUE] = table[MAX_COUNTS]
        self._own = np.zeros((n, service.OWN), dtype=np.int64)
        for d, (spec, scale) in enumerate(zip(specs, scales, strict=True)):
            self.objects[d, slots.WATCHDOG] = round(spec.watchdog_s * 1e6)
            self._own[d, service.NODE] = spec.node_id
            self._own[d, service.HOST] = scale.host_id
            self._own[d, service.LENGTH] = scale.answer_bytes
            self._lookups[spec.bus][spec.node_id] = d
        self.command = self.objects[:, slots.COMMAND]
        self.operation_enabled = self.objects[:, slots.ENABLED]
        self.objects[:, slots.LETS_GO] = 1  # there is no other stop
        self.commands = self.objects[:, slots.COMMANDS]
        self.senders = np.zeros(_CAPACITY, dtype=np.int32)
        self.synced = self.switched = False
        self._now = 0
        nothing = frame_buffer(1)
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
        service.proceed(self.objects, self._now)

    def receive(self, bus: int, frames: Frames, start: int, count: int) -> int:
        """Take all frames of one bus; return ``count``.

        Args:
            bus: Index of the bus.
            frames: Batch, (capacity, 16), rows in the order they came.
            start: First row to take.
            count: Rows filled.
        """
        what: int = service.receive(
            frames, start, count, self._lookups[bus], self.objects, self._own, self._wire,
            self._radians, self._now,
        )  # fmt: skip
        self.synced = bool(what & service.SYNCED)
        self.switched = bool(what & service.SWITCHED)
        return count

    def answer(self, bus: int, out: Frames) -> int:
        """Fill in what the drives of one bus send now; return how many rows.

        Args:
            bus: Index of the bus.
            out: Batch to fill from row 0, (capacity, 16); ``senders`` says whose they are.
        """
        rows: int = service.answer(
            out, self.senders, self._members[bus], self.objects, self._own, self._wire,
            self._radians,
        )  # fmt: skip
        return rows

    def fault(self, drive: int, error: int) -> None:
        """Put a drive into an error: it leaves motor mode and is not to be put into it.

        Args:
            drive: Drive.
            error: Error code, 1 to 255, in its long answers; 0 ends the error.
        """
        self.objects[drive, slots.ERROR_CODE] = error
        if error:
            self.objects[drive, [slots.ENABLED, slots.COMMAND]] = 0
