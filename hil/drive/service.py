"""What the emulated drives do with a frame: kernels over all drives, no Python objects.

A service of the rig is: :func:`receive` up to a SYNC, which puts held RPDOs into force;
the plant, which writes position, velocity and torque actual; then :func:`answer`, which
sends what is due. Statusword, mode display and the torque to follow are always up to date.

Source: CiA 301, "PDO transmission types", "SYNC"; CiA 402-2, state machine.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.cia402 import states
from dftc_rt.drives.cia402.objects import CST, OPERATIONAL
from hil.drive import slots

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

# Entries of the lookup table that are no RPDO.
IGNORE: Final = -1
MANAGED: Final = -2  # NMT, SDO, a heartbeat that is listened to: for Python
SYNC: Final = -3

# Why receive() stopped.
AT_END: Final = 0
AT_SYNC: Final = 1
AT_MANAGED: Final = 2

_CST = CST
_OPERATIONAL = OPERATIONAL


@njit(cache=True)
def refresh(objects: I64, d: int) -> None:
    """Bring statusword, mode display and command of one drive up to date."""
    row = objects[d]
    state = row[slots.STATE]
    if row[slots.MODE] == 0 or row[slots.MODE] == _CST:
        row[slots.MODE_DISPLAY] = row[slots.MODE]
    status = states.STATE_BITS[state] | states.VOLTAGE_ENABLED | states.REMOTE
    enabled = state == states.OPERATION_ENABLED
    command = 0
    if enabled and row[slots.MODE_DISPLAY] == _CST:
        limit = row[slots.MAX_TORQUE]
        command = min(max(row[slots.TARGET_TORQUE], -limit), limit)
        status |= states.FOLLOWS_COMMAND
        if command != row[slots.TARGET_TORQUE]:
            status |= states.INTERNAL_LIMIT
    row[slots.ENABLED] = 1 if enabled else 0
    if enabled:
        row[slots.LETS_GO] = 0
    row[slots.COMMAND] = command
    row[slots.STATUSWORD] = status


@njit(cache=True)
def control(objects: I64, d: int, previous: int) -> None:
    """Let one drive obey its controlword.

    Args:
        objects: All drives, (n, N_OBJECTS).
        d: Drive.
        previous: Controlword before this one, for the rising edge of bit 7.
    """
    row = objects[d]
    state = row[slots.STATE]
    if state == states.FAULT and row[slots.FAULT_PRESENT]:
        return
    after = states.next_state(state, row[slots.CONTROLWORD], previous, row[slots.QUICK_STOP_OPTION])
    if after != state:
        row[slots.STATE] = after
        if state == states.FAULT:
            row[slots.ERROR_CODE] = 0
            row[slots.ERROR_REGISTER] = 0
            row[slots.RESET_PENDING] = 1


@njit(cache=True)
def _apply(objects: I64, pdo: I64, d: int, p: int, data: int) -> None:
    """Put the data of one RPDO into the objects it maps."""
    row = pdo[d, p]
    previous = objects[d, slots.CONTROLWORD]
    shift = 0
    controlled = False
    for k in range(row[slots.COUNT]):
        at = slots.ENTRIES + slots.ENTRY * k
        slot = row[at]
        bits = row[at + 1]
        value = (data >> shift) & ((1 << bits) - 1)
        if row[at + 2] and value >> (bits - 1):
            value -= 1 << bits
        objects[d, slot] = value
        controlled = controlled or slot == slots.CONTROLWORD
        if slot == slots.TARGET_TORQUE:
            objects[d, slots.COMMANDS] += 1
        shift += bits
    if controlled:
        control(objects, d, previous)
    refresh(objects, d)


@njit(cache=True)
def receive(
    frames: U8, start: int, count: int, lookup: I32, members: I64, objects: I64, pdo: I64, now: int
) -> int:
    """Take frames until a SYNC, a frame for Python, or the end; drives off the bus hear none.

    RPDOs of type 254 and 255 act at once, those of type 0 to 240 at the SYNC, which ends
    the call with their values in force.

    Args:
        frames: Batch, (capacity, 16).
        start: First row to take.
        count: Rows filled.
        lookup: Identifier -> drive·4 + RPDO number, or IGNORE, MANAGED, SYNC; (2048,).
        members: Drives on this bus, (m,).
        objects: All drives, (n, N_OBJECTS).
        pdo: All PDOs, (n, 8, N_PDO).
        now: Rig time, µs.

    Returns:
        Row after the last one taken, times 4, plus AT_END, AT_SYNC or AT_MANAGED.
    """
    words = frames.view(np.int64)
    for r in range(start, count):
        head = words[r, 0]
        can_id = head & 0xFFFFFFFF
        if can_id > 0x7FF:
            continue  # 29 bits, remote or error frame: nothing a drive listens to
        what = int(lookup[can_id])
        if what == IGNORE:
            continue
        if what == MANAGED:
            return (r + 1) * 4 + AT_MANAGED
        if what == SYNC:
            for k in range(members.shape[0]):
                d = members[k]
                for p in range(4):
                    if pdo[d, p, slots.PENDING]:
                        pdo[d, p, slots.PENDING] = 0
                        if objects[d, slots.NMT] == _OPERATIONAL and not objects[d, slots.OFF_BUS]:
                            _apply(objects, pdo, d, p, pdo[d, p, slots.DATA])
            return (r + 1) * 4 + AT_SYNC
        while what >= 0:
            d = what >> 2
            p = what & 3
            what = pdo[d, p, slots.NEXT]
            if objects[d, slots.NMT] != _OPERATIONAL or objects[d, slots.OFF_BUS]:
                continue
            if (head >> 32) & 0xFF < pdo[d, p, slots.LENGTH]:
                objects[d, slots.LENGTH_ERROR] = 1
                continue
            objects[d, slots.RPDO_TIME] = now
            if pdo[d, p, slots.TYPE] <= 240:
                pdo[d, p, slots.DATA] = words[r, 1]
                pdo[d, p, slots.PENDING] = 1
            else:
                _apply(objects, pdo, d, p, words[r, 1])
    return count * 4 + AT_END


@njit(cache=True)
def proceed(objects: I64, now: int) -> int:
    """Take the steps that drives take by themselves; return how many want attention.

    Transition 12 when a quick stop has come to a stand (options 1 to 3; at once with 0),
    transition 14 when the fault reaction is over, and the RPDO watchdog.

    Args:
        objects: All drives, (n, N_OBJECTS).
        now: Rig time, µs.
    """
    attention = 0
    for d in range(objects.shape[0]):
        row = objects[d]
        state = row[slots.STATE]
        standing = abs(row[slots.VELOCITY]) <= row[slots.STANDSTILL]
        if state == states.QUICK_STOP_ACTIVE:
            option = row[slots.QUICK_STOP_OPTION]
            if option == 0 or (option < 5 and standing):
                row[slots.STATE] = states.SWITCH_ON_DISABLED
                refresh(objects, d)
        elif state == states.FAULT_REACTION_ACTIVE:
            if row[slots.FAULT_OPTION] == 0 or standing:
                row[slots.STATE] = states.FAULT
                refresh(objects, d)
        elif state == states.OPERATION_ENABLED and row[slots.WATCHDOG] > 0:
            last = row[slots.RPDO_TIME]
            if last >= 0 and now - last > row[slots.WATCHDOG]:
                row[slots.TIMED_OUT] = 1
        if row[slots.TIMED_OUT]:
            attention += 1
    return attention


@njit(cache=True)
def _due(row: I64, counter: int) -> bool:
    """Whether a synchronous TPDO goes out with this SYNC; counts the SYNC."""
    every = row[slots.TYPE]
    first = row[slots.SYNC_START]
    if first > 0 and counter > 0:
        if row[slots.PHASE] < 0:
            if counter != first:
                return False
            row[slots.PHASE] = 0
        # Counted on the SYNC's own counter: a lost SYNC does not shift the stagger.
        return bool((counter - first + 1) % every == 0)
    row[slots.PHASE] = max(row[slots.PHASE], 0) + 1
    if row[slots.PHASE] >= every:
        row[slots.PHASE] = 0
        return True
    return False


@njit(cache=True)
def answer(
    out: U8, senders: I32, members: I64, objects: I64, pdo: I64, sync_counter: int, now: int
) -> int:
    """Write the TPDOs that are due on one bus, in node order.

    Args:
        out: Batch to fill from row 0, (capacity, 16).
        senders: Drive of each row, filled, (>= capacity,).
        members: Drives on this bus, (m,).
        objects: All drives, (n, N_OBJECTS).
        pdo: All PDOs, (n, 8, N_PDO).
        sync_counter: Counter of the SYNC being answered, 0 without one, −1: no SYNC.
        now: Rig time, µs.

    Returns:
        Rows written, plus 65536 times the drives that have an emergency to send.
    """
    words = out.view(np.int64)
    capacity = out.shape[0]
    rows = 0
    attention = 0
    synced = sync_counter >= 0
    for k in range(members.shape[0]):
        d = members[k]
        if objects[d, slots.RESET_PENDING] or objects[d, slots.LENGTH_ERROR]:
            attention += 1
        if objects[d, slots.NMT] != _OPERATIONAL or objects[d, slots.OFF_BUS]:
            continue
        for p in range(4, 8):
            row = pdo[d, p]
            if row[slots.VALID] == 0 or rows >= capacity:
                continue
            kind = row[slots.TYPE]
            if kind <= 240 and not synced:
                continue
            due = 1 <= kind <= 240 and _due(row, sync_counter)
            if 1 <= kind <= 240 and not due:
                continue
            data = np.int64(0)
            shift = 0
            for e in range(row[slots.COUNT]):
                at = slots.ENTRIES + slots.ENTRY * e
                bits = row[at + 1]
                data |= (objects[d, row[at]] & ((1 << bits) - 1)) << shift
                shift += bits
            if not due:  # type 0, 254, 255: only when there is something new
                elapsed = now - row[slots.SENT]
                new = row[slots.PENDING] or data != row[slots.DATA] or row[slots.SENT] < 0
                if kind >= 254:
                    timer = row[slots.EVENT_TIMER]
                    new = new or (timer > 0 and elapsed >= timer)
                    if row[slots.SENT] >= 0 and elapsed < row[slots.INHIBIT]:
                        new = False
                if not new:
                    continue
            row[slots.PENDING] = 0
            row[slots.DATA] = data
            row[slots.SENT] = now
            words[rows, 0] = row[slots.COB_ID] | (row[slots.LENGTH] << 32)
            words[rows, 1] = data
            senders[rows] = d
            rows += 1
    return rows + 65536 * attention
