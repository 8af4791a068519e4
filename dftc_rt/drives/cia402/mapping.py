"""The PDOs our controller wants, as the SDO writes that make them.

Torque actual is slow, so the drives of a bus take turns: its TPDO is of type n and every
drive counts from a SYNC start value of its own, which needs the SYNC counter (1019h).
Three joints at 1 kHz and 1 Mbit/s, worst case: SYNC 65, RPDO1 3 · 95, TPDO1 3 · 135 and
one TPDO3 75 bits are 830 of 1000 in a cycle; TPDO2 (85) is rare and its inhibit time
keeps even a chattering status of all three below 26 bits a cycle.

Source: CiA 301, "RPDO mapping parameter" (procedure for re-mapping: destroy the PDO,
clear the count, write the entries, write the count, create the PDO).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from dftc_rt.drives.cia402 import objects as od

INVALID: Final = 1 << 31
NO_RTR: Final = 1 << 30

EVERY_SYNC: Final = 1
EVENT: Final = 255
_STATUS_TIMER_MS: Final = 500  # TPDO2 comes at least this often, should one get lost

# Abort codes by which a drive says that it has no such PDO.
ABSENT: Final = (0x0602_0000, 0x0609_0011)

_COMMAND: Final = (od.CONTROLWORD << 16 | 16, od.TARGET_TORQUE << 16 | 16)
_FEEDBACK: Final = (od.POSITION_ACTUAL << 16 | 32, od.VELOCITY_ACTUAL << 16 | 32)
_STATUS: Final = (od.STATUSWORD << 16 | 16, od.MODE_DISPLAY << 16 | 8)
_TORQUE: Final = (od.TORQUE_ACTUAL << 16 | 16,)

Write = tuple[int, int, int]


def _pdo(
    index: int, cob_id: int, entries: tuple[int, ...], rest: dict[int, int]
) -> Iterator[Write]:
    """Yield the writes (index, sub-index, value) that re-map one PDO."""
    yield index, 1, cob_id | INVALID
    for subindex, value in rest.items():
        yield index, subindex, value
    yield index + 0x200, 0, 0
    for k, entry in enumerate(entries, start=1):
        yield index + 0x200, k, entry
    yield index + 0x200, 0, len(entries)
    yield index, 1, cob_id


def writes(node_id: int, turn: int) -> Iterator[Write]:
    """Yield the SDO writes (index, sub-index, value) that map all PDOs of one drive.

    Args:
        node_id: Node id.
        turn: The drive's place among those of its bus, from 0.
    """
    yield from _pdo(0x1400, od.RPDO[0] + node_id, _COMMAND, {2: EVERY_SYNC})
    yield from _pdo(0x1800, od.TPDO[0] + node_id | NO_RTR, _FEEDBACK, {2: EVERY_SYNC, 6: 0})
    yield from _pdo(
        0x1801,
        od.TPDO[1] + node_id | NO_RTR,
        _STATUS,
        {2: EVENT, 3: od.STATUS_INHIBIT_100US, 5: _STATUS_TIMER_MS + 7 * turn},
    )
    yield from _pdo(
        0x1802,
        od.TPDO[2] + node_id | NO_RTR,
        _TORQUE,
        {2: od.TORQUE_ACTUAL_EVERY, 6: 1 + turn % od.TORQUE_ACTUAL_EVERY},
    )


def unused(node_id: int) -> Iterator[tuple[int, int]]:
    """Yield (index, COB-ID) that disable the PDOs we do not use, where they exist."""
    for number in (1, 2, 3):
        yield 0x1400 + number, od.RPDO[number] + node_id | INVALID
    yield 0x1803, od.TPDO[3] + node_id | INVALID | NO_RTR
