"""The emulated drive against canopen's own CiA 402 master, an independent implementation.

canopen's ``BaseNode402`` finds the drive as it powers on, reads its PDOs over SDO, walks
the state machine, sets the mode, stops and resets it. The network between the two is a
direct one: what the master sends is served before ``send_message`` returns.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from dftc_rt.drives.cia402.objects import EDS_PATH
from hil.drive import slots
from tests.unit.drives.drive_bus import DriveBus, drives_of, scales

pytestmark = pytest.mark.realtime


class DirectNetwork(canopen.Network):
    """canopen's network on a DriveBus; a service of the rig takes one millisecond."""

    def __init__(self, bus: DriveBus) -> None:
        super().__init__()
        self.direct = bus
        self.t = 0.0

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        assert not remote
        self.t += 1e-3
        self.direct.drives.tick(self.t)
        for answer, payload in self.direct.exchange((can_id, bytes(data))):
            self.notify(answer, bytearray(payload), self.t)


@pytest.fixture
def bus() -> DriveBus:
    return DriveBus(drives_of(scales(2)))


@pytest.fixture
def master(bus: DriveBus) -> Iterator[BaseNode402]:
    """A master that has read the drive's PDOs and started it."""
    threads = threading.active_count()
    network = DirectNetwork(bus)
    node = BaseNode402(2, str(EDS_PATH))
    network.add_node(node)
    node.nmt.state = "PRE-OPERATIONAL"
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    yield node
    assert threading.active_count() == threads


def test_walks_to_operation_enabled_and_back(master: BaseNode402, bus: DriveBus) -> None:
    assert master.state == "SWITCH ON DISABLED"
    for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
        master.state = state
        assert master.state == state
    assert bus.drives.operation_enabled.tolist() == [0, 1]  # node 1 was not spoken to
    for state in ("SWITCHED ON", "READY TO SWITCH ON", "SWITCH ON DISABLED"):
        master.state = state
        assert master.state == state


def test_goes_there_in_one_assignment(master: BaseNode402, bus: DriveBus) -> None:
    master.state = "OPERATION ENABLED"
    assert bus.drives.enabled(1)


def test_mode_is_set_and_shown(master: BaseNode402) -> None:
    assert master.op_mode == "NO MODE"
    master.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    assert master.op_mode == "CYCLIC SYNCHRONOUS TORQUE"
    assert not master.is_op_mode_supported("HOMING")


def test_torque_by_sdo_is_followed(master: BaseNode402, bus: DriveBus) -> None:
    master.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    master.state = "OPERATION ENABLED"
    master.sdo["Target torque"].raw = -250
    assert bus.drives.command.tolist() == [0, -250]


def test_quick_stop_and_enable_again(master: BaseNode402, bus: DriveBus) -> None:
    master.sdo["Quick stop option code"].raw = 6  # stay in quick stop active
    master.state = "OPERATION ENABLED"
    master.state = "QUICK STOP ACTIVE"
    assert master.state == "QUICK STOP ACTIVE"
    assert not bus.drives.enabled(1)
    master.state = "OPERATION ENABLED"
    assert bus.drives.enabled(1)


def test_fault_is_seen_and_reset(master: BaseNode402, bus: DriveBus) -> None:
    master.TIMEOUT_RESET_FAULT = 0.0  # canopen waits for the edge that it sends afterwards
    master.state = "OPERATION ENABLED"
    bus.drives.fault(1, 0x3210)
    master.network.send_message(0x7E5, b"")  # any frame: time goes on
    assert master.state == "FAULT"
    assert [hex(error.code) for error in master.emcy.active] == ["0x3210"]
    assert master.sdo["Error code"].raw == 0x3210
    master.reset_from_fault()
    assert bus.drives.enabled(1)
    assert master.emcy.active == []


def test_pdos_are_remapped_by_canopen(master: BaseNode402, bus: DriveBus) -> None:
    master.nmt.state = "PRE-OPERATIONAL"
    master.tpdo[1].clear()
    for name in ("Position actual value", "Velocity actual value"):
        master.tpdo[1].add_variable(name)
    master.tpdo[1].trans_type = 1
    master.rpdo[1].clear()
    for name in ("Controlword", "Target torque"):
        master.rpdo[1].add_variable(name)
    master.rpdo[1].trans_type = 1
    master.tpdo[1].save()
    master.rpdo[1].save()
    master.nmt.state = "OPERATIONAL"
    bus.drives.objects[1, slots.POSITION] = -123_456
    bus.drives.objects[1, slots.VELOCITY] = 789
    master.sdo["Modes of operation"].raw = 10
    for word in (6, 7, 15):
        master.rpdo[1]["Controlword"].raw = word
        master.rpdo[1]["Target torque"].raw = 2 * word
        master.rpdo[1].transmit()
        master.network.sync.transmit()
    assert bus.drives.command.tolist() == [0, 30]
    assert master.tpdo[1]["Position actual value"].raw == -123_456
    assert master.tpdo[1]["Velocity actual value"].raw == 789


def test_heartbeat_reaches_canopen(master: BaseNode402) -> None:
    states: list[int] = []
    master.nmt.add_heartbeat_callback(states.append)
    master.sdo["Producer heartbeat time"].raw = 20
    for _ in range(100):
        master.network.send_message(0x7E5, b"")
    assert states == [5] * 4


def test_torque_actual_is_what_the_drive_measures_and_no_more(
    master: BaseNode402, bus: DriveBus
) -> None:
    # The rig writes current times nominal torque constant; the wire carries that number
    # and none of the standard's objects carries another.
    bus.drives.objects[1, slots.TORQUE_ACTUAL] = 400
    assert master.sdo["Torque actual value"].raw == 400
    assert all(index < 0x2000 or index >= 0x6000 for index in master.object_dictionary)
