"""Registers of a moteus drive: numbers, modes, and what an integer of each is worth.

A register may be read and written as int8, int16, int32 or float. A float is in the unit of the
register; an integer counts steps of it, and the most negative one stands for NaN.

Source: [moteus], "Register Reference".
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

# Formats of a value on the wire.
INT8: Final = 0
INT16: Final = 1
INT32: Final = 2
FLOAT: Final = 3

MODE: Final = 0x000
POSITION: Final = 0x001  # rev, at the output
VELOCITY: Final = 0x002  # rev/s
TORQUE: Final = 0x003  # Nm, at the output
FAULT: Final = 0x00F
COMMAND: Final = 0x020  # from here on: what a command consists of
COMMAND_POSITION: Final = 0x020  # rev; NaN: where it is
COMMAND_VELOCITY: Final = 0x021  # rev/s
COMMAND_TORQUE: Final = 0x022  # feed-forward, Nm
COMMAND_KP_SCALE: Final = 0x023  # 1
COMMAND_KD_SCALE: Final = 0x024  # 1
COMMAND_MAX_TORQUE: Final = 0x025  # Nm; NaN: the drive's own limit
COMMAND_TIMEOUT: Final = 0x027  # s; 0: the drive's own setting, NaN: none
COMMANDS: Final = 14  # registers of a command

# Values of MODE.
STOPPED: Final = 0  # writing it clears a fault
FAULTED: Final = 1
PREPARING: Final = 4  # 2 to 4: between stopped and in operation
IN_POSITION: Final = 10  # "position mode"
TIMED_OUT: Final = 11  # the watchdog has fired; only "stopped" leads out of it

# Units of the registers: rows of STEPS.
WHOLE: Final = 0
REVOLUTIONS: Final = 1
REVOLUTIONS_PER_S: Final = 2
NEWTON_METRES: Final = 3
AMPERES: Final = 4
VOLTS: Final = 5
DEGREES_C: Final = 6
SECONDS: Final = 7
FRACTION: Final = 8
WATTS: Final = 9
REVOLUTIONS_PER_S2: Final = 10

STEPS: Final = np.array(
    [
        [1.0, 1.0, 1.0, 1.0],
        [1e-2, 1e-4, 1e-5, 1.0],
        [1e-1, 2.5e-4, 1e-5, 1.0],
        [0.5, 1e-2, 1e-3, 1.0],
        [1.0, 1e-1, 1e-3, 1.0],
        [0.5, 1e-1, 1e-3, 1.0],
        [1.0, 1e-1, 1e-3, 1.0],
        [1e-2, 1e-3, 1e-6, 1.0],
        [1 / 127, 1 / 32767, 1 / 2147483647, 1.0],
        [10.0, 5e-2, 1e-4, 1.0],
        [5e-2, 1e-3, 1e-5, 1.0],
    ]
)
"""What one count of a unit is worth, by format."""

NONE: Final = -1
_W, _P, _V, _T, _A, _U, _C, _S, _F, _X = (
    WHOLE, REVOLUTIONS, REVOLUTIONS_PER_S, NEWTON_METRES, AMPERES, VOLTS, DEGREES_C, SECONDS,
    FRACTION, REVOLUTIONS_PER_S2,
)  # fmt: skip
_N = NONE
_UNITS: Final = np.array(
    [
        _W, _P, _V, _T, _A, _A, _P, WATTS, _N, _N, _C, _W, _W, _U, _C, _W,  # state
        _N, _N, _N, _N, _N, _N, _N, _N, _N, _N, _N, _N, _N, _N, _N, _N,
        _P, _V, _T, _F, _F, _T, _P, _S, _V, _X, _U, _F, _A, _W,  # command
    ]
)  # fmt: skip


@njit(cache=True)
def unit_of(register: int) -> int:
    """Return the unit of a register, a row of ``STEPS``; NONE for one that is not known here."""
    if 0 <= register < _UNITS.shape[0]:
        return int(_UNITS[register])
    return NONE
