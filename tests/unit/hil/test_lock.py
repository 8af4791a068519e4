"""A joint that a fault blocks, while its drive goes on as if nothing were."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from dftc_rt.bus.frame import BARRIER_ID, frame_buffer, pack, unpack
from dftc_rt.bus.interface import FrameSocket
from dftc_rt.config.faults import LockFault
from dftc_rt.config.scenario import DriveTable, PlantTable, RigTable, RobotTable, Scenario
from dftc_rt.dynamics.model import Robot
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.memory import MemorySink
from hil.faults import compile_faults
from hil.plants.rigid_body import RigidBodyPlant
from hil.simulate import in_process_rig
from tests.unit.drives.drive_bus import sdo_write


@pytest.fixture(scope="module")
def arm2() -> Robot:
    return load_robot("arm2")


def plant_of(
    robot: Robot, *faults: LockFault, v0: tuple[float, float] = (0.0, 0.0)
) -> RigidBodyPlant:
    """A plant at 1 kHz, brakes open, no lag."""
    plant = RigidBodyPlant(
        robot,
        PlantTable(),
        DriveTable(torque_lag_s=0.0),
        compile_faults(faults, robot.joints),
        1e-3,
        robot.home,
        np.array(v0),
    )
    plant.set_brakes(np.ones(2, dtype=bool))
    return plant


def test_it_stands_exactly_from_start_to_end_and_the_rest_moves(arm2: Robot) -> None:
    plant = plant_of(arm2, LockFault(joint="joint2", start_s=0.1, end_s=0.2), v0=(0.3, -0.4))
    plant.advance(400)
    stood, q1 = plant.q[1], plant.q[0]
    assert plant.v[1] != 0.0
    plant.advance(399)
    assert plant.q[1] == stood
    assert plant.v[1] == 0.0
    assert plant.q[0] != q1
    plant.advance(1)
    plant.advance(4)
    assert plant.q[1] != stood


def test_stopping_it_is_an_impulse_at_that_joint_alone(arm2: Robot) -> None:
    locked = plant_of(arm2, LockFault(joint="joint2"), v0=(0.3, -0.4))
    braked = plant_of(arm2, v0=(0.3, -0.4))
    braked.set_brakes(np.array([True, False]))
    locked.advance(4)
    braked.advance(4)
    np.testing.assert_array_equal(locked.q, braked.q)
    np.testing.assert_array_equal(locked.v, braked.v)
    assert locked.v[0] != 0.3


def test_the_motor_pushes_on_and_nothing_of_it_arrives(arm2: Robot) -> None:
    plant = plant_of(arm2, LockFault(joint="joint2"))
    plant.command[:] = 3.0
    plant.advance(4)
    plant.reveal()
    assert plant.motor.tolist() == [3.0, 3.0]  # what the drive reports: its current
    assert plant.applied.tolist() == [3.0, 0.0]
    assert plant.rho.tolist() == [1.0, 0.0]
    assert plant.fault.tolist() == [0.0, 1.0]
    assert plant.released.all()


def test_a_brake_that_closes_and_opens_meanwhile_does_not_free_it(arm2: Robot) -> None:
    plant = plant_of(arm2, LockFault(joint="joint2"))
    plant.advance(4)
    stood = plant.q[1]
    plant.set_brakes(np.array([True, False]))
    plant.set_brakes(np.array([True, True]))
    plant.advance(40)
    assert plant.q[1] == stood


def test_every_joint_locked_is_an_arm_that_stands(arm2: Robot) -> None:
    plant = plant_of(arm2, LockFault(joint="joint1"), LockFault(joint="joint2"), v0=(0.3, -0.4))
    plant.command[:] = 3.0
    plant.advance(40)
    assert plant.q.tolist() == arm2.home.tolist()
    assert plant.applied.tolist() == [0.0, 0.0]


def talk(node: FrameSocket, *frames: tuple[int, bytes]) -> dict[int, bytes]:
    """Send some frames; return what comes back, the last of each identifier."""
    batch = frame_buffer(32)
    for row, (can_id, data) in enumerate(frames):
        batch[row] = np.frombuffer(pack(can_id, data), dtype=np.uint8)
    node.send(batch, len(frames))
    return dict(unpack(batch[row].copy()) for row in range(node.receive(batch)))


def test_on_the_bus_a_position_that_stands_and_a_drive_that_knows_of_nothing(arm2: Robot) -> None:
    scenario = Scenario(
        name="lock",
        robot=RobotTable(name="arm2"),
        rig=RigTable(drive=DriveTable(velocity_noise_rad_s=0.0)),
        fault=(LockFault(joint="joint2", start_s=0.05, end_s=0.1),),
    )
    motion = np.zeros((3, 2))
    motion[0] = arm2.home
    node = in_process_rig(scenario, arm2, motion, MemorySink(13), lambda *_: None).sockets[0]
    for n in (1, 2):
        for index, sub, value, size in (
            (0x6060, 0, 10, 1),
            (0x1402, 2, 1, 1), (0x1402, 1, 0x400 + n, 4),  # controlword, torque
            (0x1802, 2, 1, 1), (0x1802, 1, 0x4000_0380 + n, 4),  # position, velocity
            (0x1803, 2, 1, 1), (0x1803, 1, 0x4000_0480 + n, 4),  # torque actual
        ):  # fmt: skip
            talk(node, (0x600 + n, sdo_write(index, sub, value, size)))
    talk(node, (0, b"\x01\x00"))
    seen = []
    for k in range(120):
        data = struct.pack("<Hh", (6, 7, 15)[min(k, 2)], 60)
        commands = [(0x401, data), (0x402, data), (0x80, b"")]
        seen.append(talk(node, *commands, (BARRIER_ID, struct.pack("<Q", k))))
    at = np.array(
        [[struct.unpack("<ii", f[0x381]), struct.unpack("<ii", f[0x382])] for f in seen]
    )  # cycle, joint, (position, velocity)
    assert np.all(np.diff(at[10:, 0, 0]) != 0)
    assert np.all(np.diff(at[10:50, 1, 0]) != 0)
    assert np.all(at[50:101, 1, 0] == at[50, 1, 0])
    assert np.all(at[51:101, 1, 1] == 0)
    assert np.all(np.diff(at[105:, 1, 0]) != 0)
    for frames in seen[60:]:
        assert struct.unpack("<h", frames[0x482]) == (60,)  # its current, as it was told
        assert not {0x82, 0x182} & set(frames)  # no emergency, no change of its state
