"""What falsified encoders show in the frames of TPDO3, against values worked out by hand."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from dftc_rt.config.faults import (
    Fault,
    SensorBiasFault,
    SensorBitsFault,
    SensorFrozenFault,
    SensorNoiseFault,
)
from dftc_rt.drives.scale import ScaleTable
from hil.drive import slots
from hil.drive.sensor_faults import SensorFaults
from tests.unit.drives.drive_bus import DriveBus, drives_of, scales, write

JOINTS = ("joint1", "joint2")
TURN = 100_000  # counts: 1000 a motor turn, gear 100


class Encoders:
    """Two drives whose TPDO3 comes with every SYNC; joint2's motor turns against its joint."""

    def __init__(self, *faults: Fault, seed: int = 1) -> None:
        sheets = [*scales(1), *scales(2, sign=-1)[1:]]
        self.bus = DriveBus(drives_of(sheets))
        self.faults = SensorFaults(faults, JOINTS, ScaleTable.of(sheets), seed)
        for node in (1, 2):
            write(self.bus, node, 0x1802, 2, 1, 1)
            write(self.bus, node, 0x1802, 1, 0x4000_0380 + node, 4)
        self.bus.exchange((0, b"\x01\x00"))

    def show(self, t: float, position: int, velocity: int = 7) -> list[tuple[int, int]]:
        """Return (position, velocity) on the bus when both joints truly have these counts."""
        self.bus.drives.objects[:, slots.POSITION] = position
        self.bus.drives.objects[:, slots.VELOCITY] = velocity
        self.faults.apply(t, self.bus.drives.objects)
        frames = dict(self.bus.exchange((0x80, b"")))
        found = [struct.unpack("<ii", frames[0x380 + node]) for node in (1, 2)]
        return [(int(q), int(v)) for q, v in found]


def test_bias_is_in_radians_of_the_joint() -> None:
    turn = Encoders(SensorBiasFault(joint="joint2", start_s=1.0, end_s=2.0, bias_rad=math.pi / 2))
    assert turn.show(0.999, 500) == [(500, 7), (500, 7)]
    assert turn.show(1.0, 500) == [(500, 7), (500 - TURN // 4, 7)]
    assert turn.show(2.0, 500) == [(500, 7), (500, 7)]


def test_a_frozen_encoder_stands_and_goes_on_where_the_joint_is() -> None:
    frozen = Encoders(SensorFrozenFault(joint="joint1", start_s=1.0, end_s=2.0))
    assert frozen.show(0.5, 10)[0] == (10, 7)
    assert [frozen.show(t, q)[0] for t, q in ((1.0, 20), (1.5, 99))] == [(20, 0), (20, 0)]
    assert frozen.show(1.5, 99)[1] == (99, 7)
    assert frozen.show(2.0, 120)[0] == (120, 7)


@pytest.mark.parametrize(("true", "seen"), [(0, 0), (15, 0), (16, 16), (-1, -16), (-16, -16)])
def test_lost_bits_read_0(true: int, seen: int) -> None:
    bits = Encoders(SensorBitsFault(joint="joint1", bits=4))
    assert bits.show(0.0, true) == [(seen, 7), (true, 7)]


def test_noise_has_its_deviations_and_no_memory() -> None:
    count = math.tau / TURN
    noise = Encoders(
        SensorNoiseFault(joint="joint1", position_rad=50 * count, velocity_rad_s=200 * count)
    )
    found = np.array([noise.show(k * 1e-3, 0, 0)[0] for k in range(4000)], dtype=float)
    np.testing.assert_allclose(found.std(axis=0), [50, 200], rtol=0.05)
    assert np.abs(found.mean(axis=0) / [50, 200]).max() < 0.06
    assert abs(np.corrcoef(found[1:, 0], found[:-1, 0])[0, 1]) < 0.06
    assert abs(np.corrcoef(found.T)[0, 1]) < 0.06


def test_noise_is_repeatable_and_of_its_seed() -> None:
    def first(seed: int) -> list[int]:
        noise = Encoders(SensorNoiseFault(joint="joint1", position_rad=0.1), seed=seed)
        return [noise.show(k * 1e-3, 0)[0][0] for k in range(5)]

    assert first(1) == first(1)
    assert first(1) != first(2)


def test_several_on_a_joint_in_the_order_of_the_encoder() -> None:
    # Written the other way round: still bias, then lost bits, then the standstill.
    both = Encoders(
        SensorFrozenFault(joint="joint1", start_s=1.0),
        SensorBitsFault(joint="joint1", bits=4),
        SensorBiasFault(joint="joint1", bias_rad=10 * math.tau / TURN),
    )
    assert both.show(0.0, 7)[0][0] == 16
    assert both.show(1.0, 30)[0][0] == 32
    assert both.show(1.1, 90)[0][0] == 32
