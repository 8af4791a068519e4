"""What the emulated drives measure: encoder, velocity with noise, motor current.

A drive knows its current, so its torque actual (6077h) is current times the nominal
torque constant: a loss of effectiveness does not show in it.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import DriveTable
from dftc_rt.drives.scale import RAD_PER_COUNT, TORQUE_PER_COUNT, ZERO_OFFSET, ScaleTable
from hil.drive import slots

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_BLOCK: Final = 4096  # noise drawn at a time, per joint


@numba.njit(cache=True)
def _latch(
    q: F64, v: F64, motor: F64, scale: F64, resolution: float, noise: F64, objects: I64
) -> None:
    for i in range(q.shape[0]):
        seen = np.rint((q[i] + scale[ZERO_OFFSET, i]) / resolution) * resolution
        objects[i, slots.POSITION] = np.int64(np.rint(seen / scale[RAD_PER_COUNT, i]))
        objects[i, slots.VELOCITY] = np.int64(np.rint((v[i] + noise[i]) / scale[RAD_PER_COUNT, i]))
        torque = np.rint(motor[i] / scale[TORQUE_PER_COUNT, i])
        objects[i, slots.TORQUE_ACTUAL] = np.int64(min(max(torque, -32768.0), 32767.0))


@numba.njit(cache=True)
def torque_commands(objects: I64, scale: F64, command: F64) -> None:
    """Put what the drives want into the motors.

    Args:
        objects: The drives, (n, N_OBJECTS).
        scale: ``ScaleTable.values``.
        command: Out, (n,), Nm: torque each current loop is to follow; 0 where off.
    """
    for i in range(command.shape[0]):
        command[i] = objects[i, slots.COMMAND] * scale[TORQUE_PER_COUNT, i]


class Sensors:
    """Latches the plant's state into the drives' objects.

    Each joint draws its noise from a stream of its own, so that one joint's faults or
    another number of joints never change what the others see.
    """

    def __init__(self, drive: DriveTable, scales: ScaleTable, seed: int, n: int) -> None:
        """Seed the streams; nothing is drawn before the first :meth:`latch`."""
        self._resolution = 2.0 * np.pi / 2.0**drive.encoder_bits
        self._std = drive.velocity_noise_rad_s
        self._scale = scales.values
        self._streams = [
            np.random.default_rng(np.random.SeedSequence([seed, 0x5E45, joint]))
            for joint in range(n)
        ]
        self._noise = np.zeros((_BLOCK, n))
        self._next = _BLOCK

    def latch(self, q: F64, v: F64, motor: F64, objects: I64) -> None:
        """Write position, velocity and torque actual into ``objects``, with fresh noise."""
        if self._next == _BLOCK:
            if self._std > 0:
                for joint, stream in enumerate(self._streams):
                    self._noise[:, joint] = stream.normal(0.0, self._std, _BLOCK)
            self._next = 0
        _latch(q, v, motor, self._scale, self._resolution, self._noise[self._next], objects)
        self._next += 1

    def preset(self, q: F64, objects: I64) -> None:
        """Write a pose at rest into ``objects``, without noise: what set-up reads."""
        zero = np.zeros(q.shape[0])
        _latch(q, zero, zero, self._scale, self._resolution, zero, objects)
