"""Set-up of CiA 402 drives over CANopen: NMT, SDO, PDO mapping, modes, state machine.

Everything here happens before the loop starts and after it has ended, in the caller's
thread; it may raise, wait and allocate. On success it depends on no clock.

A drive is left switched on, not operation enabled: that step is taken by the first cyclic
RPDO, together with the first torque, so that gravity is held when the brake opens.

Source: CiA 301 (NMT, SDO, PDO), CiA 402-2 (state machine, objects).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import numpy as np
from canopen.objectdictionary import ObjectDictionaryError
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError, SdoError

from dftc_rt.bus.interface import FrameSocket
from dftc_rt.drives.cia402 import mapping, states
from dftc_rt.drives.cia402 import objects as od
from dftc_rt.drives.cia402.eds import dictionary
from dftc_rt.drives.cia402.network import PumpedNode, SocketNetwork
from dftc_rt.drives.interface import DriveConfig, SetUp
from dftc_rt.errors import BusError, DriveError, InputError

_DRIVE_HEARTBEAT_MS: Final = 100
_QUICK_STOP_THEN_OFF: Final = 2  # 605Ah: slow down on the quick stop ramp, then switch off
_KEEP_NMT_STATE: Final = 1  # 1029h:01h: feedback goes on after a communication error
_SHUTDOWN_TIMEOUT_S: Final = 0.1  # a drive that is there answers at once
_POLLS: Final = 1000  # looks at the statusword before a state counts as not reached


class Cia402Client:
    """The controller's CANopen master for all drives of a robot."""

    def __init__(
        self,
        sockets: Sequence[FrameSocket],
        drives: Sequence[DriveConfig],
        rate_hz: float,
        timeout_s: float = 1.0,
    ) -> None:
        """Attach to the buses; nothing is sent yet.

        Args:
            sockets: One per bus.
            drives: The drives, in joint order.
            rate_hz: SYNC frequency.
            timeout_s: Longest wait for one answer, s.

        Raises:
            InputError: Two drives of a bus share a node id.
        """
        self._drives = tuple(drives)
        self._period_us = round(1e6 / rate_hz)
        self._networks = [SocketNetwork(socket, timeout_s) for socket in sockets]
        self._nodes: list[PumpedNode] = []
        for drive in drives:
            network = self._networks[drive.bus]
            if drive.node_id in network:
                raise InputError(
                    drive.scale.joint, f"node id {drive.node_id} is taken on {network.socket.name}"
                )
            node = PumpedNode(drive.node_id, dictionary(drive.node_id))
            network[drive.node_id] = node
            self._nodes.append(node)

    def configure(self) -> SetUp:
        """Bring every drive from whatever state it is in to switched on.

        Raises:
            DriveError: A drive is missing, is not what the robot file says, refuses a
                setting, or has a fault that cannot be reset.
            BusError: A bus has gone away.
        """
        for network in self._networks:
            network.pump()
        for i, node in enumerate(self._nodes):  # each by name: others may share the bus
            self._network(i).send_message(od.NMT, [od.NMT_PRE_OPERATIONAL, node.id])
        for i in range(len(self._nodes)):
            with self._blame(i):
                self._check_identity(i)
                self._disable(i)
                self._set_parameters(i)
                self._map_pdos(i)
        for i, drive in enumerate(self._drives):
            with self._blame(i):
                self._network(i).send_message(od.NMT, [od.NMT_START, drive.node_id])
                self._walk(i, states.CW_SHUTDOWN, states.READY_TO_SWITCH_ON)
                self._walk(i, states.CW_SWITCH_ON, states.SWITCHED_ON)
        n = len(self._drives)
        found = SetUp(np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64))
        for i in range(n):
            with self._blame(i):
                found.statusword[i] = self._read(i, od.STATUSWORD)
                found.counts[i] = self._read(i, od.POSITION_ACTUAL)
        for network in self._networks:
            network.pump()
        return found

    def examine(self) -> tuple[str, ...]:
        """Read what every drive is: SDO uploads, nothing else is sent.

        Returns:
            What is wrong with each drive, "" with one that is what the robot file says.

        Raises:
            BusError: A bus has gone away.
        """
        found: list[str] = []
        for i in range(len(self._drives)):
            try:
                with self._blame(i):
                    self._check_identity(i)
                found.append("")
            except DriveError as error:
                found.append(error.what)
        return tuple(found)

    def shutdown(self) -> tuple[str, ...]:
        """Disable voltage on every drive and leave the operational state, best effort.

        Returns:
            Joints whose drive did not confirm.
        """
        silent = []
        for network in self._networks:
            network.timeout_s = min(network.timeout_s, _SHUTDOWN_TIMEOUT_S)
        for i, drive in enumerate(self._drives):
            try:
                self._network(i).pump()
                self._write(i, od.CONTROLWORD, states.CW_DISABLE_VOLTAGE)
                self._write(i, od.HEARTBEAT_CONSUMER, 0, 1)  # ours ends here, and that is no fault
                if states.state_of(self._read(i, od.STATUSWORD)) not in (
                    states.SWITCH_ON_DISABLED,
                    states.FAULT,
                ):
                    silent.append(drive.scale.joint)
            except (SdoError, BusError):
                silent.append(drive.scale.joint)
        for i, node in enumerate(self._nodes):
            try:
                self._network(i).send_message(od.NMT, [od.NMT_PRE_OPERATIONAL, node.id])
            except BusError:
                continue  # its joint is in the list already
        return tuple(silent)

    # --- steps of configure ----------------------------------------------------------

    def _check_identity(self, i: int) -> None:
        """Compare what the drive says it is with the robot file."""
        scale = self._drives[i].scale
        device = self._read(i, od.DEVICE_TYPE)
        if device & 0xFFFF != od.DEVICE_PROFILE:
            raise self._error(i, f"device type 1000h is 0x{device:08X}, not a CiA 402 drive")
        modes = self._read(i, od.SUPPORTED_MODES)
        if not modes & od.CST_SUPPORTED:
            raise self._error(
                i, f"supported modes 6502h are 0x{modes:X}: no cyclic synchronous torque"
            )
        rated = self._read(i, od.RATED_TORQUE)
        if abs(rated - scale.rated_torque_mnm) > max(1, scale.rated_torque_mnm // 1000):
            raise self._mismatch(i, "rated torque 6076h", rated, scale.rated_torque_mnm, "mNm")
        counts = self._read(i, od.ENCODER_RESOLUTION, 1)
        turns = self._read(i, od.ENCODER_RESOLUTION, 2)
        if counts != scale.counts_per_rev * turns:
            raise self._mismatch(
                i, "encoder resolution 608Fh", counts / turns, scale.counts_per_rev, "counts/rev"
            )
        motor = self._read(i, od.GEAR_RATIO, 1)
        shaft = self._read(i, od.GEAR_RATIO, 2)
        if abs(motor - scale.gear * shaft) > 1e-4 * motor:
            raise self._mismatch(i, "gear ratio 6091h", motor / shaft, scale.gear, "")

    def _disable(self, i: int) -> None:
        """Take power off, resetting a fault if there is one."""
        self._write(i, od.CONTROLWORD, states.CW_DISABLE_VOLTAGE)
        state = self._wait_state(i, states.SWITCH_ON_DISABLED, states.FAULT)
        if state == states.FAULT:
            code = self._read(i, od.ERROR_CODE)
            self._write(i, od.CONTROLWORD, states.CW_FAULT_RESET)
            state = self._wait_state(i, states.SWITCH_ON_DISABLED)
            if state == states.FAULT:
                raise self._error(i, f"fault 603Fh 0x{code:04X} cannot be reset")
        if state != states.SWITCH_ON_DISABLED:
            raise self._error(i, f"is in state '{states.STATE_NAMES[state]}' after disable voltage")

    def _set_parameters(self, i: int) -> None:
        """Write everything but the PDOs."""
        value, exponent = _interpolation_period(self._period_us)
        self._write(i, od.SYNC_PERIOD, 0)  # 1019h may only change while this is 0
        self._write(i, od.SYNC_OVERFLOW, od.SYNC_COUNTER_OVERFLOW)
        self._write(i, od.SYNC_PERIOD, self._period_us)
        self._write(i, od.INTERPOLATION_PERIOD, value, 1)
        self._write(i, od.INTERPOLATION_PERIOD, exponent, 2)
        self._write(i, od.TARGET_TORQUE, 0)
        self._write(i, od.MAX_TORQUE, self._drives[i].scale.max_counts)
        self._write(i, od.QUICK_STOP_OPTION, _QUICK_STOP_THEN_OFF)
        self._write(i, od.ABORT_CONNECTION_OPTION, od.ABORT_FAULT)
        self._write(i, od.ERROR_BEHAVIOUR, _KEEP_NMT_STATE, 1)
        patience_ms = 3 * od.MASTER_HEARTBEAT_MS
        self._write(i, od.HEARTBEAT_CONSUMER, od.MASTER_NODE_ID << 16 | patience_ms, 1)
        self._write(i, od.HEARTBEAT_PRODUCER, _DRIVE_HEARTBEAT_MS)
        self._write(i, od.MODE, od.CST)
        mode = self._read(i, od.MODE_DISPLAY)
        if mode != od.CST:
            raise self._error(i, f"mode display 6061h is {mode} after mode {od.CST} was set")

    def _map_pdos(self, i: int) -> None:
        """Map the PDOs; the drives of a bus take turns with their slow one."""
        drive = self._drives[i]
        turn = sum(other.bus == drive.bus for other in self._drives[:i])
        for index, subindex, value in mapping.writes(drive.node_id, turn):
            self._write(i, index, value, subindex)
        for index, value in mapping.unused(drive.node_id):
            try:
                self._write(i, index, value, 1)
            except SdoAbortedError as refusal:
                if refusal.code not in mapping.ABSENT:
                    raise

    def _walk(self, i: int, controlword: int, state: int) -> None:
        """Take one step of the state machine."""
        self._write(i, od.CONTROLWORD, controlword)
        reached = self._wait_state(i, state)
        if reached != state:
            raise self._error(
                i,
                f"stays in state '{states.STATE_NAMES[reached]}', "
                f"wanted '{states.STATE_NAMES[state]}'",
            )

    def _wait_state(self, i: int, *wanted: int) -> int:
        """Return the state once it is one of those wanted, or after many looks."""
        state = states.NOT_READY_TO_SWITCH_ON
        for _ in range(_POLLS):
            state = states.state_of(self._read(i, od.STATUSWORD))
            if state in wanted:
                break
        return state

    # --- one object ------------------------------------------------------------------

    def _read(self, i: int, index: int, subindex: int = 0) -> int:
        """Read an object by SDO."""
        node = self._nodes[i]
        variable = node.object_dictionary.get_variable(index, subindex)
        assert variable is not None
        data = node.sdo.upload(index, subindex)
        try:
            value = variable.decode_raw(data)
        except ObjectDictionaryError:
            what = f"answers {len(data)} bytes for object {index:04X}h:{subindex:02X}h"
            raise self._error(i, f"{what}, not {len(variable) // 8}") from None
        assert isinstance(value, int)
        return value

    def _write(self, i: int, index: int, value: int, subindex: int = 0) -> None:
        """Write an object by SDO."""
        node = self._nodes[i]
        variable = node.object_dictionary.get_variable(index, subindex)
        assert variable is not None
        try:
            node.sdo.download(index, subindex, variable.encode_raw(value))
        except SdoAbortedError as refusal:
            refusal.add_note(f"object {index:04X}h:{subindex:02X}h := {value}")
            raise

    # --- errors ----------------------------------------------------------------------

    def _network(self, i: int) -> SocketNetwork:
        """Return the network of a drive's bus."""
        return self._networks[self._drives[i].bus]

    def _error(self, i: int, what: str) -> DriveError:
        """Return an error that names a drive."""
        drive = self._drives[i]
        return DriveError(drive.scale.joint, drive.node_id, self._network(i).socket.name, what)

    def _mismatch(self, i: int, what: str, found: float, expected: float, unit: str) -> DriveError:
        """Return the error for a drive that is not what the robot file says."""
        unit = f" {unit}" if unit else ""
        return self._error(i, f"{what} is {found:g}{unit}, the robot file says {expected:g}{unit}")

    @contextmanager
    def _blame(self, i: int) -> Iterator[None]:
        """Turn canopen's errors into one line that names the drive."""
        try:
            yield
        except SdoCommunicationError as silence:
            seconds = self._network(i).timeout_s
            raise self._error(i, f"no answer to SDO within {seconds:g} s") from silence
        except SdoAbortedError as refusal:
            where = "; ".join(getattr(refusal, "__notes__", ()))
            raise self._error(i, f"refused {where or 'a read'}: {refusal}") from refusal


def _interpolation_period(period_us: int) -> tuple[int, int]:
    """Return object 60C2h, (value, exponent): period = value · 10^exponent s."""
    exponent = -6
    while period_us % 10 == 0 and exponent < 0:
        period_us //= 10
        exponent += 1
    while period_us > 255:
        period_us = round(period_us / 10)
        exponent += 1
    return period_us, exponent
