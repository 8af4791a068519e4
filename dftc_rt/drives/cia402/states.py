"""The CiA 402 drive state machine as a table, shared by both ends of the wire.

``TRANSITIONS`` is the figure of the standard, one row per arrow that a controlword can
take; ``NEXT`` is the same as an array for kernels. The two arrows that a drive takes by
itself (12 when a quick stop is complete, 14 when the fault reaction is complete) and the
one that a fault takes (13) are the drive's own business and not in the table.

Source: CiA 402-2, clause "Finite state automaton" (figure and table of transitions),
"Object 6040h: Controlword", "Object 6041h: Statusword".
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

NOT_READY_TO_SWITCH_ON: Final = 0
SWITCH_ON_DISABLED: Final = 1
READY_TO_SWITCH_ON: Final = 2
SWITCHED_ON: Final = 3
OPERATION_ENABLED: Final = 4
QUICK_STOP_ACTIVE: Final = 5
FAULT_REACTION_ACTIVE: Final = 6
FAULT: Final = 7

STATE_NAMES: Final = (
    "not ready to switch on",
    "switch on disabled",
    "ready to switch on",
    "switched on",
    "operation enabled",
    "quick stop active",
    "fault reaction active",
    "fault",
)

# Commands, as the controlword's bits 7, 3, 2, 1, 0 spell them.
DISABLE_VOLTAGE: Final = 0  # x x x 0 x
QUICK_STOP: Final = 1  # x x 0 1 x
SHUTDOWN: Final = 2  # x x 1 1 0
SWITCH_ON: Final = 3  # x 0 1 1 1, "disable operation" when it comes from above
ENABLE_OPERATION: Final = 4  # x 1 1 1 1
FAULT_RESET: Final = 5  # rising edge of bit 7

# Controlwords that give those commands.
CW_DISABLE_VOLTAGE: Final = 0x00
CW_QUICK_STOP: Final = 0x02
CW_SHUTDOWN: Final = 0x06
CW_SWITCH_ON: Final = 0x07
CW_ENABLE_OPERATION: Final = 0x0F
CW_FAULT_RESET: Final = 0x80

TRANSITIONS: Final = (
    (2, SWITCH_ON_DISABLED, SHUTDOWN, READY_TO_SWITCH_ON),
    (3, READY_TO_SWITCH_ON, SWITCH_ON, SWITCHED_ON),
    (3, READY_TO_SWITCH_ON, ENABLE_OPERATION, SWITCHED_ON),  # 4 follows at once
    (4, SWITCHED_ON, ENABLE_OPERATION, OPERATION_ENABLED),
    (5, OPERATION_ENABLED, SWITCH_ON, SWITCHED_ON),
    (6, SWITCHED_ON, SHUTDOWN, READY_TO_SWITCH_ON),
    (7, READY_TO_SWITCH_ON, DISABLE_VOLTAGE, SWITCH_ON_DISABLED),
    (7, READY_TO_SWITCH_ON, QUICK_STOP, SWITCH_ON_DISABLED),
    (8, OPERATION_ENABLED, SHUTDOWN, READY_TO_SWITCH_ON),
    (9, OPERATION_ENABLED, DISABLE_VOLTAGE, SWITCH_ON_DISABLED),
    (10, SWITCHED_ON, DISABLE_VOLTAGE, SWITCH_ON_DISABLED),
    (10, SWITCHED_ON, QUICK_STOP, SWITCH_ON_DISABLED),
    (11, OPERATION_ENABLED, QUICK_STOP, QUICK_STOP_ACTIVE),
    (12, QUICK_STOP_ACTIVE, DISABLE_VOLTAGE, SWITCH_ON_DISABLED),
    (15, FAULT, FAULT_RESET, SWITCH_ON_DISABLED),
    (16, QUICK_STOP_ACTIVE, ENABLE_OPERATION, OPERATION_ENABLED),  # options 5 to 8 only
)
"""(number in the figure, from, command, to)."""


def _next_table() -> NDArray[np.int64]:
    """The table as an array: (8 states, 6 commands) -> state; no arrow: stay."""
    table = np.repeat(np.arange(8, dtype=np.int64)[:, None], 6, axis=1)
    for _, start, command, end in TRANSITIONS:
        table[start, command] = end
    return table


NEXT: Final = _next_table()

# Statusword bits of each state (bits 6, 5, 3, 2, 1, 0), bit 5 "quick stop" being low
# only while a quick stop is active.
STATE_BITS: Final = np.array([0x00, 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08], dtype=np.int64)

VOLTAGE_ENABLED: Final = 1 << 4
REMOTE: Final = 1 << 9
INTERNAL_LIMIT: Final = 1 << 11
FOLLOWS_COMMAND: Final = 1 << 12


@njit(cache=True)
def command_of(controlword: int) -> int:
    """Return the command (0 to 4) that a controlword spells, bit 7 aside."""
    if controlword & 0x02 == 0:
        return DISABLE_VOLTAGE
    if controlword & 0x04 == 0:
        return QUICK_STOP
    if controlword & 0x01 == 0:
        return SHUTDOWN
    if controlword & 0x08 == 0:
        return SWITCH_ON
    return ENABLE_OPERATION


@njit(cache=True)
def next_state(state: int, controlword: int, previous: int, quick_stop_option: int) -> int:
    """Return the state after a drive has received a controlword.

    Args:
        state: Present state.
        controlword: 6040h as received now.
        previous: 6040h as received before, for the rising edge of bit 7.
        quick_stop_option: 605Ah; transition 16 exists with options 5 to 8 only.

    Source: CiA 402-2, table of transitions.
    """
    if state == FAULT:
        if controlword & 0x80 and not previous & 0x80:
            return int(NEXT[FAULT, FAULT_RESET])
        return state
    command = command_of(controlword)
    if state == QUICK_STOP_ACTIVE and command == ENABLE_OPERATION and quick_stop_option < 5:
        return state
    after = int(NEXT[state, command])
    if state == READY_TO_SWITCH_ON and command == ENABLE_OPERATION:
        after = int(NEXT[after, command])  # 3 and 4 in one go
    return after


@njit(cache=True)
def state_of(statusword: int) -> int:
    """Return the state that a statusword shows.

    Source: CiA 402-2, table "State coding" of object 6041h.
    """
    low = statusword & 0x4F
    if low == 0x00:
        return NOT_READY_TO_SWITCH_ON
    if low == 0x40:
        return SWITCH_ON_DISABLED
    if low == 0x08:
        return FAULT
    if low == 0x0F:
        return FAULT_REACTION_ACTIVE
    with_quick_stop = statusword & 0x6F
    if with_quick_stop == 0x21:
        return READY_TO_SWITCH_ON
    if with_quick_stop == 0x23:
        return SWITCHED_ON
    if with_quick_stop == 0x27:
        return OPERATION_ENABLED
    if with_quick_stop == 0x07:
        return QUICK_STOP_ACTIVE
    return NOT_READY_TO_SWITCH_ON
