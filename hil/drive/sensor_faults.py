"""Encoders that fail: what the drives report is no longer what is true.

Per joint, in this order: bias, noise, lost bits, and last the reading that stands still.

Source: docs/faults.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config import faults as kinds
from dftc_rt.config.faults import Fault, SensorFault
from dftc_rt.drives.scale import RAD_PER_COUNT, ScaleTable
from hil.drive import slots

_ORDER: Final = (
    kinds.SensorBiasFault,
    kinds.SensorNoiseFault,
    kinds.SensorBitsFault,
    kinds.SensorFrozenFault,
)


class SensorFaults:
    """Falsifies positions and velocities that have been latched."""

    def __init__(
        self, faults: Sequence[Fault], joints: Sequence[str], scales: ScaleTable, seed: int
    ) -> None:
        """Take the faults of sensors. Each that is random has a stream of its own.

        Args:
            faults: The scenario's; others are passed over.
            joints: Joint of each drive; the faults' joints are among them.
            scales: What a count is worth.
            seed: The scenario's.
        """
        self._joints = joints
        self._seed = seed
        self._faults: list[tuple[int, SensorFault, np.random.Generator]] = []
        self._rad_per_count = scales.values[RAD_PER_COUNT]
        self._held: dict[SensorFault, int] = {}  # position, counts
        self.change(faults)

    def change(self, faults: Sequence[Fault]) -> None:
        """Take other faults; of those that were there, streams and held positions go on."""
        streams = {fault: stream for _, fault, stream in self._faults}
        found = [(k, fault) for k, fault in enumerate(faults) if isinstance(fault, SensorFault)]
        found.sort(key=lambda entry: _ORDER.index(type(entry[1])))
        self._faults = []
        for k, fault in found:
            stream = streams.get(fault)
            if stream is None:
                stream = np.random.default_rng(np.random.SeedSequence([self._seed, 0x5E46, k]))
            self._faults.append((self._joints.index(fault.joint), fault, stream))

    def apply(self, t: float, objects: NDArray[np.int64]) -> None:
        """Falsify what was latched at rig time ``t``, s.

        Args:
            t: Rig time, s.
            objects: The drives, (n, N_OBJECTS); POSITION and VELOCITY change.
        """
        for joint, fault, stream in self._faults:
            if not fault.start_s <= t < fault.end_s:
                self._held.pop(fault, None)
                continue
            row, count = objects[joint], self._rad_per_count[joint]
            match fault:
                case kinds.SensorBiasFault():
                    row[slots.POSITION] += round(fault.bias_rad / count)
                case kinds.SensorNoiseFault():
                    position, velocity = stream.normal(size=2)
                    row[slots.POSITION] += round(fault.position_rad * position / count)
                    row[slots.VELOCITY] += round(fault.velocity_rad_s * velocity / count)
                case kinds.SensorBitsFault():
                    row[slots.POSITION] &= -1 << fault.bits
                case kinds.SensorFrozenFault():
                    row[slots.POSITION] = self._held.setdefault(fault, int(row[slots.POSITION]))
                    row[slots.VELOCITY] = 0
