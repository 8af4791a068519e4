"""One emulated drive's object dictionary, served by canopen, compiled for the kernels.

Process objects are read from and written to the ``objects`` matrix; PDO parameters are
checked as CiA 301 wants them and compiled into the ``pdo`` matrix; the rest stays in
canopen's store, whose defaults are the EDS file's.

Source: CiA 301, "Object dictionary", "RPDO communication parameter" to "TPDO mapping
parameter", "Abort SDO transfer protocol" (abort codes).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import canopen
import numpy as np
from canopen.sdo.exceptions import SdoAbortedError
from numpy.typing import NDArray

from dftc_rt.drives.cia402 import objects as co
from dftc_rt.drives.cia402.eds import dictionary
from dftc_rt.drives.scale import JointScale
from hil.drive import aborts, service, slots
from hil.drive.sdo_server import DriveSdoServer

_INVALID_PDO: Final = 1 << 31
_EXTENDED: Final = 1 << 29
_RESTRICTED: Final = (range(0x001, 0x080), range(0x580, 0x600), range(0x600, 0x680))


class DriveNode(canopen.LocalNode):
    """A drive as SDO sees it.

    Attributes:
        scale: The drive's data sheet.
        error_history: Object 1003h, newest first.
        consumer: Object 1016h:01h, (producer's node id, time in µs); (0, 0) when off.
        heard_us: Rig time of that producer's last heartbeat, µs; −1: not yet, which
            is when it is not watched either.
    """

    def __init__(
        self,
        node_id: int,
        scale: JointScale,
        objects: NDArray[np.int64],
        pdo: NDArray[np.int64],
        rewired: Callable[[], None],
    ) -> None:
        """Read the EDS file and power on.

        Args:
            node_id: Node id.
            scale: The drive's data sheet.
            objects: This drive's row of the matrix, (N_OBJECTS,).
            pdo: This drive's PDOs, (8, N_PDO).
            rewired: Called when identifiers that the drive listens to have changed.
        """
        super().__init__(node_id, dictionary(node_id))
        self.sdo: DriveSdoServer = DriveSdoServer(
            co.SDO_REQUEST + node_id, co.SDO_RESPONSE + node_id, self
        )
        self.scale = scale
        self.error_history: list[int] = []
        self.consumer = (0, 0)
        self.heard_us = -1
        self._objects = objects
        self._pdo = pdo
        self._rewired = rewired
        self.add_read_callback(self._on_read)  # type: ignore[no-untyped-call]
        self.add_write_callback(self._on_write)  # type: ignore[no-untyped-call]

    def load_defaults(self, everything: bool) -> None:
        """Go back to power-on values: all of them, or the communication area's alone."""
        if everything:
            self.data_store.clear()
            self.error_history.clear()
        for index in [i for i in self.data_store if 0x1000 <= i < 0x2000]:
            del self.data_store[index]
        self.consumer = (0, 0)
        self.heard_us = -1
        self.sdo.forget()
        motor, shaft = self.scale.gear_ratio
        for index, subindex, value in (
            (co.RATED_TORQUE, 0, self.scale.rated_torque_mnm),
            (co.ENCODER_RESOLUTION, 1, self.scale.counts_per_rev),
            (co.GEAR_RATIO, 1, motor),
            (co.GEAR_RATIO, 2, shaft),
        ):
            variable = self.object_dictionary.get_variable(index, subindex)
            assert variable is not None
            self.data_store.setdefault(index, {})[subindex] = variable.encode_raw(value)
        for number in range(8):
            self._compile_communication(number)
            self._compile_mapping(number, self.value(_mapping(number), 0))

    def value(self, index: int, subindex: int = 0) -> int:
        """Return an object's present value."""
        data = self.get_data(index, subindex)
        variable = self.object_dictionary.get_variable(index, subindex)
        assert variable is not None
        value = variable.decode_raw(data)
        assert isinstance(value, int)
        return value

    def _on_read(self, index: int, subindex: int, od: Any) -> int | None:
        """Return a live value, or None to let canopen look in its store."""
        live = slots.LIVE.get((index, subindex))
        if live is not None:
            slot, bits, signed = live
            raw = int(self._objects[slot]) & ((1 << bits) - 1)
            return raw - (1 << bits) if signed and raw >> (bits - 1) else raw
        if index == co.ERROR_HISTORY:
            if subindex == 0:
                return len(self.error_history)
            if subindex > len(self.error_history):
                raise SdoAbortedError(aborts.NO_SUBINDEX if subindex > 8 else aborts.NO_DATA)
            return self.error_history[subindex - 1]
        return None

    def _on_write(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        """Check a write and let it act; canopen stores it afterwards.

        Raises:
            SdoAbortedError: The write is refused, with CiA 301's abort code.
        """
        value = od.decode_raw(bytes(data))
        if od.max is not None and value > od.max:
            raise SdoAbortedError(aborts.VALUE_TOO_HIGH)
        if od.min is not None and value < od.min:
            raise SdoAbortedError(aborts.VALUE_TOO_LOW)
        if (index, subindex) in slots.LIVE:
            self._write_live(index, subindex, value)
        elif 0x1400 <= index < 0x1404 or 0x1800 <= index < 0x1804:
            self._write_communication(_number(index), subindex, value)
        elif 0x1600 <= index < 0x1604 or 0x1A00 <= index < 0x1A04:
            self._write_mapping(_number(index), subindex, value)
        elif index == co.ERROR_HISTORY:
            if value != 0:
                raise SdoAbortedError(aborts.INVALID_VALUE)
            self.error_history.clear()
        elif index == co.HEARTBEAT_CONSUMER:
            if subindex != 1:
                raise SdoAbortedError(aborts.NO_SUBINDEX)
            producer, time_ms = value >> 16, value & 0xFFFF
            if producer > 127:
                raise SdoAbortedError(aborts.INVALID_VALUE)
            self.consumer = (producer, time_ms * 1000) if producer and time_ms else (0, 0)
            self.heard_us = -1
            self._rewired()
        elif index == co.SYNC_OVERFLOW:
            if value == 1:
                raise SdoAbortedError(aborts.INVALID_VALUE)
            if self.value(co.SYNC_PERIOD):
                raise SdoAbortedError(aborts.WRONG_STATE)

    def _write_live(self, index: int, subindex: int, value: int) -> None:
        """Write a process object and let the drive react at once."""
        if index == co.MODE and value not in (0, co.CST):
            raise SdoAbortedError(aborts.INVALID_VALUE)
        slot = slots.LIVE[index, subindex][0]
        previous = int(self._objects[slots.CONTROLWORD])
        self._objects[slot] = value
        matrix = self._objects[None, :]
        if index == co.CONTROLWORD:
            service.control(matrix, 0, previous)
        if slot == slots.TARGET_TORQUE:
            self._objects[slots.COMMANDS] += 1
        service.refresh(matrix, 0)

    def _write_communication(self, number: int, subindex: int, value: int) -> None:
        """Check and apply one PDO communication parameter (1400h, 1800h)."""
        row = self._pdo[number]
        if subindex == 1:
            cob_id = value & 0x1FFF_FFFF
            valid = not value & _INVALID_PDO
            if value & _EXTENDED or cob_id > 0x7FF:
                raise SdoAbortedError(aborts.INVALID_VALUE)
            if row[slots.VALID] and valid and cob_id != row[slots.COB_ID]:
                raise SdoAbortedError(aborts.INVALID_VALUE)
            if valid and (cob_id == 0 or any(cob_id in taken for taken in _RESTRICTED)):
                raise SdoAbortedError(aborts.INVALID_VALUE)
            row[slots.VALID] = 1 if valid else 0
            row[slots.COB_ID] = cob_id
            self.restart_pdo(number)
            self._rewired()
        elif subindex == 2:
            if 240 < value < 254:
                raise SdoAbortedError(aborts.INVALID_VALUE)
            row[slots.TYPE] = value
            self.restart_pdo(number)
        elif subindex == 3:
            if row[slots.VALID]:
                raise SdoAbortedError(aborts.INVALID_VALUE)
            row[slots.INHIBIT] = value * 100
        elif subindex == 5:
            row[slots.EVENT_TIMER] = value * 1000
            self._rewired()
        elif subindex == 6:
            if row[slots.VALID]:
                raise SdoAbortedError(aborts.INVALID_VALUE)
            row[slots.SYNC_START] = value
            self.restart_pdo(number)

    def _write_mapping(self, number: int, subindex: int, value: int) -> None:
        """Check and apply one PDO mapping parameter (1600h, 1A00h)."""
        row = self._pdo[number]
        if row[slots.VALID]:
            raise SdoAbortedError(aborts.UNSUPPORTED_ACCESS)
        if subindex == 0:
            self._compile_mapping(number, value)
        elif row[slots.COUNT]:
            raise SdoAbortedError(aborts.UNSUPPORTED_ACCESS)
        elif value:
            self._entry(number, value)

    def _entry(self, number: int, value: int) -> tuple[int, int, int]:
        """Return (slot, bits, signed) of a mapping entry.

        Raises:
            SdoAbortedError: The object does not exist or cannot be mapped.
        """
        index, subindex, bits = value >> 16, (value >> 8) & 0xFF, value & 0xFF
        if index not in self.object_dictionary:
            raise SdoAbortedError(aborts.NO_OBJECT)
        row = slots.MAPPABLE.get((index, subindex))
        if row is None or bits != row[1] or not row[3 if number < 4 else 4]:
            raise SdoAbortedError(aborts.NOT_MAPPABLE)
        return row[:3]

    def _compile_mapping(self, number: int, count: int) -> None:
        """Turn the first ``count`` mapping entries into columns of the matrix."""
        row = self._pdo[number]
        entries = [
            self._entry(number, self.value(_mapping(number), k)) for k in range(1, count + 1)
        ]
        bits = sum(entry[1] for entry in entries)
        if bits > 64:
            raise SdoAbortedError(aborts.MAPPING_TOO_LONG)
        row[slots.COUNT] = count
        row[slots.LENGTH] = bits // 8
        for k, entry in enumerate(entries):
            at = slots.ENTRIES + slots.ENTRY * k
            row[at : at + slots.ENTRY] = entry

    def _compile_communication(self, number: int) -> None:
        """Turn stored communication parameters into columns of the matrix."""
        index = _communication(number)
        row = self._pdo[number]
        cob_id = self.value(index, 1)
        row[slots.VALID] = 0 if cob_id & _INVALID_PDO else 1
        row[slots.COB_ID] = cob_id & 0x7FF
        row[slots.TYPE] = self.value(index, 2)
        row[slots.INHIBIT] = self.value(index, 3) * 100
        row[slots.EVENT_TIMER] = self.value(index, 5) * 1000
        row[slots.SYNC_START] = self.value(index, 6) if number >= 4 else 0
        self.restart_pdo(number)

    def restart_pdo(self, number: int) -> None:
        """Forget held data and the SYNC count; an event-driven TPDO is due at once."""
        row = self._pdo[number]
        row[slots.PHASE] = -1
        row[slots.PENDING] = 0
        row[slots.SENT] = -1


def _number(index: int) -> int:
    """Return the PDO's place in the matrix: RPDOs 0 to 3, TPDOs 4 to 7."""
    return (index & 0x1FF) + (4 if index >= 0x1800 else 0)


def _communication(number: int) -> int:
    """Return the index of a PDO's communication parameter."""
    return 0x1400 + number if number < 4 else 0x1800 + number - 4


def _mapping(number: int) -> int:
    """Return the index of a PDO's mapping parameter."""
    return _communication(number) + 0x200
