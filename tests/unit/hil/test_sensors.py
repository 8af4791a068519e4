"""What the drives measure: resolution, noise, current."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dftc_rt.config.scenario import DriveTable
from dftc_rt.drives.scale import JointScale, ScaleTable
from hil.drive import slots
from hil.drive.sensors import Sensors, torque_commands

F64 = NDArray[np.float64]
COUNTS = 1 << 20  # per revolution of the joint


def table(n: int, sign: int = 1, zero_offset_rad: float = 0.0) -> ScaleTable:
    return ScaleTable.of(
        [
            JointScale(f"j{i}", COUNTS, 50.0, 100.0, sign=sign, zero_offset_rad=zero_offset_rad)
            for i in range(n)
        ]
    )


def objects(n: int) -> NDArray[np.int64]:
    return np.zeros((n, slots.N_OBJECTS), dtype=np.int64)


def latched(sensors: Sensors, q: F64, v: F64, motor: F64) -> NDArray[np.int64]:
    found = objects(q.size)
    sensors.latch(q, v, motor, found)
    return found


@pytest.mark.parametrize("bits", [4, 12, 19])
def test_encoder_resolution(bits: int) -> None:
    drive = DriveTable(encoder_bits=bits, velocity_noise_rad_s=0.0)
    scales, step = table(1), 2 * np.pi / 2**bits
    sensors = Sensors(drive, scales, 1, 1)
    true = np.linspace(-3.0, 3.0, 997)
    seen = np.empty_like(true)
    for k, q in enumerate(true):
        found = latched(sensors, np.array([q]), np.zeros(1), np.zeros(1))
        seen[k] = scales.position(found[:, slots.POSITION])[0]
    np.testing.assert_allclose(seen / step, np.rint(true / step), rtol=0, atol=1e-6)
    assert np.abs(seen - true).max() <= step / 2 * (1 + 1e-9)


def test_sign_and_offset_are_undone_by_the_scale() -> None:
    scales = table(1, sign=-1, zero_offset_rad=0.5)
    sensors = Sensors(DriveTable(velocity_noise_rad_s=0.0), scales, 1, 1)
    found = latched(sensors, np.array([0.3]), np.array([-0.7]), np.array([20.0]))
    assert found[0, slots.POSITION] < 0
    assert scales.position(found[:, slots.POSITION])[0] == pytest.approx(0.3, abs=1.2e-5)
    assert scales.velocity(found[:, slots.VELOCITY])[0] == pytest.approx(-0.7, abs=6e-6)
    assert found[0, slots.TORQUE_ACTUAL] == -400  # 20 Nm of 50 Nm rated, motor reversed


def velocities(n: int, seed: int, cycles: int = 5000, std: float = 0.002) -> NDArray[np.int64]:
    sensors = Sensors(DriveTable(velocity_noise_rad_s=std), table(n), seed, n)
    zero, found = np.zeros(n), objects(n)
    sensors.preset(zero, found)  # draws nothing
    seen = np.empty((cycles, n), dtype=np.int64)
    for k in range(cycles):
        sensors.latch(zero, zero, zero, found)
        seen[k] = found[:, slots.VELOCITY]
    return seen


def test_noise_has_its_deviation_and_is_white() -> None:
    noise = velocities(2, seed=3) * 2 * np.pi / COUNTS
    assert noise.std(axis=0) == pytest.approx([0.002, 0.002], rel=0.05)
    assert np.abs(noise.mean(axis=0)).max() < 2e-4
    assert abs(np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]) < 0.05
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.05


def test_a_joints_noise_is_its_own_whatever_the_others() -> None:
    three, seven = velocities(3, seed=3), velocities(7, seed=3)
    assert np.array_equal(three, seven[:, :3])
    assert not np.array_equal(three[:, 0], three[:, 1])
    assert not np.array_equal(three, velocities(3, seed=4))


def test_preset_draws_nothing() -> None:
    drive, n = DriveTable(), 2
    zero = np.zeros(n)
    plain, preset = Sensors(drive, table(n), 1, n), Sensors(drive, table(n), 1, n)
    found = objects(n)
    for _ in range(3):
        preset.preset(np.array([0.1, 0.2]), found)
    assert not found[:, slots.VELOCITY].any()
    assert found[:, slots.POSITION].all()
    assert np.array_equal(latched(plain, zero, zero, zero), latched(preset, zero, zero, zero))


def test_torque_commands() -> None:
    found = objects(2)
    found[:, slots.COMMAND] = [100, -200]
    command = np.zeros(2)
    torque_commands(found, table(2).values, command)
    assert command == pytest.approx([5.0, -10.0])
