"""``dftc rig`` in a process of its own against canopen's CiA 402 master, over the user-space bus.

The other file in this folder does the same in one process; here frames, processes and threads
are real. Rig time follows the clock; watchdogs are long: a stall of the host proves nothing.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ODVariable
from canopen.profiles.p402 import BaseNode402

from dftc_rt.drives.cia402.objects import EDS_PATH
from tests.integration.commands import DFTC, Started, started, until

pytestmark = pytest.mark.realtime

RIG = (
    DFTC, "rig", "panda_shoulder_loss", "--bus", "unix", "--set", "fault=[]",
    "--set", "executor.rate_hz=200", "--set", "rig.drive.watchdog_s=60.0",
)  # fmt: skip
SYNC_S = 0.01
PATIENCE_S = 30.0  # for whatever the host does meanwhile
COMPILING_S = 300.0  # where nothing has been compiled yet


def ready(run: Started) -> None:
    """Wait for the rig's buses."""
    deadline = time.monotonic() + COMPILING_S
    while "Ctrl-C ends" not in run.err:
        assert run.process.poll() is None, run.err
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[canopen.Network]:
    """A network on can0 of a rig that runs; SYNC every 10 ms."""
    folder = tmp_path_factory.mktemp("rig")
    directory = folder / "bus"
    with started(folder / "run", *RIG, "--bus-dir", directory) as run:
        ready(run)
        with canopen.Network() as joined:
            joined.connect(interface="dftc", channel="can0", bus_dir=directory)
            joined.sync.start(SYNC_S)
            yield joined
            joined.sync.stop()
        run.process.send_signal(signal.SIGINT)
        assert run.end() == 0
        assert "Traceback" not in run.err
    assert not Path(directory).exists()
    until(lambda: threading.active_count() == 1, "canopen's threads")


@pytest.fixture
def master(network: canopen.Network) -> Iterator[BaseNode402]:
    """A master of node 1, which has just been reset and started."""
    node = BaseNode402(1, str(EDS_PATH))
    for timeout in ("SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE", "CHECK_TPDO"):
        setattr(node, f"TIMEOUT_{timeout}", PATIENCE_S)
    node.TIMEOUT_RESET_FAULT = 0.0  # canopen waits for the edge that it sends afterwards
    network.add_node(node)
    boot(node, "RESET")
    node.setup_402_state_machine()
    # Statusword; torque; position and velocity: with every SYNC.
    for pdo in (node.tpdo[1], node.rpdo[3], node.tpdo[3]):
        pdo.trans_type, pdo.enabled = 1, True
        pdo.save()
    node.nmt.state = "OPERATIONAL"
    eventually(lambda: node.state, "SWITCH ON DISABLED")
    yield node
    node.nmt.state = "RESET"
    del network[1]


def boot(master: BaseNode402, command: str) -> None:
    """Send an NMT command that ends in a boot-up message, and wait for that."""
    booted = threading.Event()
    master.nmt.add_heartbeat_callback(lambda state: state == 0 and booted.set())
    master.nmt.state = command
    assert booted.wait(PATIENCE_S)


def eventually(read: Callable[[], object], wanted: object) -> None:
    until(lambda: read() == wanted, f"{wanted}")


def enable(master: BaseNode402) -> None:
    master.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    master.state = "OPERATION ENABLED"
    assert master.state == "OPERATION ENABLED"


def push(master: BaseNode402, per_mille: int) -> None:
    """Command a torque by RPDO3; it acts from the next SYNC on."""
    master.rpdo[3]["Controlword"].raw = 15
    master.rpdo[3]["Target torque"].raw = per_mille
    master.rpdo[3].transmit()


def feedback(master: BaseNode402) -> tuple[int, int]:
    """Position and velocity of the next TPDO3."""
    assert master.tpdo[3].wait_for_reception(PATIENCE_S) is not None
    return (
        master.tpdo[3]["Position actual value"].raw,
        master.tpdo[3]["Velocity actual value"].raw,
    )


def test_every_object_of_the_eds_is_read_by_its_type(master: BaseNode402) -> None:
    for entry in master.object_dictionary.values():
        if entry.index < 0x1000:
            continue  # dummies are for mapping only
        for variable in [entry] if isinstance(entry, ODVariable) else entry.values():
            if variable.index == 0x1003 and variable.subindex:
                continue  # there is no error
            data = master.sdo.upload(variable.index, variable.subindex)
            assert len(data) == len(variable) // 8 or variable.index == 0x1008
    assert master.sdo["Manufacturer device name"].raw == "CiA 402 torque drive"


def test_every_object_that_is_read_only_says_so(master: BaseNode402) -> None:
    for entry in master.object_dictionary.values():
        if entry.index < 0x1000:
            continue
        for variable in [entry] if isinstance(entry, ODVariable) else entry.values():
            if variable.writable or variable.index == 0x1003:
                continue
            size = max(len(variable) // 8, 1)
            with pytest.raises(canopen.SdoAbortedError) as refused:
                master.sdo.download(variable.index, variable.subindex, bytes(size))
            assert refused.value.code == 0x0601_0002, hex(variable.index)


def test_walks_to_operation_enabled_and_back(master: BaseNode402) -> None:
    for state in (
        "READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED",
        "SWITCHED ON", "READY TO SWITCH ON", "SWITCH ON DISABLED",
    ):  # fmt: skip
        master.state = state
        assert master.state == state


def test_torque_by_pdo_moves_the_joint_and_is_read_back(master: BaseNode402) -> None:
    enable(master)
    begun, _ = feedback(master)
    push(master, 100)
    eventually(lambda: master.sdo["Target torque"].raw, 100)
    eventually(lambda: master.sdo["Torque actual value"].raw, 100)
    until(lambda: feedback(master)[0] > begun + 1000, "the joint to move")
    push(master, 0)
    eventually(lambda: master.sdo["Torque actual value"].raw, 0)


def test_torque_by_sdo_is_held_to_the_limit(master: BaseNode402) -> None:
    enable(master)
    begun, _ = feedback(master)
    master.sdo["Max torque"].raw = 50
    master.sdo["Target torque"].raw = -80
    eventually(lambda: master.sdo["Torque actual value"].raw, -50)
    assert master.sdo["Statusword"].raw >> 11 & 1  # internal limit active
    until(lambda: feedback(master)[0] < begun - 1000, "the joint to move")
    master.sdo["Target torque"].raw = 20
    eventually(lambda: master.sdo["Torque actual value"].raw, 20)
    assert not master.sdo["Statusword"].raw >> 11 & 1


def test_quick_stop_brakes_and_stays_where_it_is_told_to(master: BaseNode402) -> None:
    master.sdo["Quick stop option code"].raw = 6
    enable(master)
    push(master, 100)
    until(lambda: feedback(master)[1] > 1000, "the joint to move")
    master.state = "QUICK STOP ACTIVE"
    assert master.state == "QUICK STOP ACTIVE"
    eventually(lambda: master.sdo["Torque actual value"].raw, 0)
    stood, _ = feedback(master)
    time.sleep(0.1)  # time in which it could move
    assert feedback(master)[0] == stood
    master.state = "OPERATION ENABLED"
    assert master.state == "OPERATION ENABLED"


def test_a_watchdog_faults_it_and_the_fault_is_reset(master: BaseNode402) -> None:
    enable(master)
    push(master, 0)
    master.sdo["RPDO communication parameter 1"]["Event timer"].raw = 200
    error = master.emcy.wait(timeout=PATIENCE_S)
    assert error is not None
    assert (error.code, error.register) == (0x8250, 0x11)  # communication: bits 0 and 4
    eventually(lambda: master.state, "FAULT")
    assert master.sdo["Error code"].raw == 0x8250
    assert master.sdo["Pre-defined error field"][1].raw == 0x8250
    master.sdo["RPDO communication parameter 1"]["Event timer"].raw = 0
    master.reset_from_fault()
    assert master.state == "OPERATION ENABLED"
    assert master.sdo["Error code"].raw == 0
    assert master.emcy.active == []


def test_reset_communication_forgets_the_mapping_and_keeps_the_profile(
    master: BaseNode402,
) -> None:
    master.sdo["Quick stop option code"].raw = 6
    boot(master, "RESET COMMUNICATION")
    assert master.sdo["RPDO communication parameter 3"]["COB-ID used by RPDO"].raw == 0x8000_0401
    assert master.sdo["Quick stop option code"].raw == 6
    boot(master, "RESET")
    assert master.sdo["Quick stop option code"].raw == 2


def test_heartbeats_tell_the_nmt_state(master: BaseNode402) -> None:
    master.sdo["Producer heartbeat time"].raw = 20
    assert master.nmt.wait_for_heartbeat(PATIENCE_S) == "OPERATIONAL"
    master.nmt.state = "PRE-OPERATIONAL"
    eventually(lambda: master.nmt.wait_for_heartbeat(PATIENCE_S), "PRE-OPERATIONAL")


def test_a_lost_heartbeat_of_the_master_faults_the_drive(master: BaseNode402) -> None:
    master.sdo["Consumer heartbeat time"][1].raw = 127 << 16 | 200
    enable(master)
    master.network.send_message(0x77F, b"\x05")
    error = master.emcy.wait(timeout=PATIENCE_S)
    assert error is not None
    assert error.code == 0x8130
    # 1029h at power-on: the node also turns pre-operational, so no PDO tells.
    eventually(lambda: master.sdo["Statusword"].raw & 0x4F, 0x08)
    eventually(lambda: master.sdo["Torque actual value"].raw, 0)
