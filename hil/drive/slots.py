"""Columns of the two matrices that hold what the emulated drives are.

``objects`` is ``(n_drives, N_OBJECTS)`` int64: the process objects (named by their CiA 402
index) and the drive's own state. ``pdo`` is ``(n_drives, 8, N_PDO)`` int64: RPDO1 to
RPDO4, then TPDO1 to TPDO4, communication and mapping parameters compiled for the kernels.

Only what a drive can know is here: its torque is current times the nominal torque
constant, whatever the actuator makes of it.

Source: CiA 301 (1400h to 1BFFh), CiA 402-2 (6000h to 67FFh).
"""

from __future__ import annotations

from typing import Final

from dftc_rt.drives.cia402 import objects as od

# --- objects: process objects, in the units of the wire
CONTROLWORD: Final = 0
STATUSWORD: Final = 1
MODE: Final = 2
MODE_DISPLAY: Final = 3
TARGET_TORQUE: Final = 4  # per mille of rated torque
MAX_TORQUE: Final = 5  # per mille of rated torque
POSITION: Final = 6  # counts; the wire carries the low 32 bits
VELOCITY: Final = 7  # counts/s
TORQUE_ACTUAL: Final = 8  # per mille of rated torque, from the current
ERROR_CODE: Final = 9
ERROR_REGISTER: Final = 10
QUICK_STOP_OPTION: Final = 11
FAULT_OPTION: Final = 12
ABORT_OPTION: Final = 13
# --- objects: the drive's own state
STATE: Final = 14  # dftc_rt.drives.cia402.states
NMT: Final = 15  # 0 initialising, 4 stopped, 5 operational, 127 pre-operational
ENABLED: Final = 16  # 1 while operation is enabled
COMMAND: Final = 17  # torque the current loop is to follow, per mille of rated; 0 when off
COMMANDS: Final = 18  # target torques actuated so far
FAULT_PRESENT: Final = 19  # 1 while the cause of a fault lasts: it cannot be reset
RESET_PENDING: Final = 20  # 1: a fault was reset, the emergency "no error" is due
LENGTH_ERROR: Final = 21  # 1: an RPDO was too short, the emergency 8210h is due
RPDO_TIME: Final = 22  # rig time of the last RPDO, µs; −1 before the first
WATCHDOG: Final = 23  # longest time between RPDOs while enabled, µs; 0: off
TIMED_OUT: Final = 24  # 1: the watchdog fired and has not been dealt with
STANDSTILL: Final = 25  # speed that counts as standing, counts/s
DUMMY: Final = 26  # where RPDO gaps (objects 0002h to 0007h) go
OFF_BUS: Final = 27  # why the node neither sends nor hears, bits as below; 0: it does both
LETS_GO: Final = 28  # 1: when it is off, it does not hold the joint until the brake has closed
N_OBJECTS: Final = 29

# --- bits of OFF_BUS
DISCONNECTED: Final = 1  # by itself, or without a supply
BUS_OFF: Final = 2  # fault confinement has taken it off

# --- pdo: columns of one PDO
VALID: Final = 0
COB_ID: Final = 1
TYPE: Final = 2
INHIBIT: Final = 3  # µs
EVENT_TIMER: Final = 4  # µs
SYNC_START: Final = 5
COUNT: Final = 6
LENGTH: Final = 7  # bytes
PHASE: Final = 8  # SYNCs since the last transmission; −1: waits for its start value
PENDING: Final = 9  # RPDO: data are held for the next SYNC; TPDO: send at the next chance
DATA: Final = 10  # RPDO: held; TPDO: last sent
SENT: Final = 11  # rig time of the last transmission, µs; −1 before the first
NEXT: Final = 12  # next RPDO with the same identifier (drive·4 + number), or −1
ENTRIES: Final = 13  # from here: slot, bits, signed of each mapped object
ENTRY: Final = 3
N_PDO: Final = ENTRIES + 8 * ENTRY

MAPPABLE: Final = {
    # (index, sub-index): (slot, bits, signed, by RPDO, by TPDO)
    (od.ERROR_REGISTER, 0): (ERROR_REGISTER, 8, 0, False, True),
    (od.ERROR_CODE, 0): (ERROR_CODE, 16, 0, False, True),
    (od.CONTROLWORD, 0): (CONTROLWORD, 16, 0, True, True),
    (od.STATUSWORD, 0): (STATUSWORD, 16, 0, False, True),
    (od.MODE, 0): (MODE, 8, 1, True, True),
    (od.MODE_DISPLAY, 0): (MODE_DISPLAY, 8, 1, False, True),
    (od.POSITION_ACTUAL, 0): (POSITION, 32, 1, False, True),
    (od.VELOCITY_ACTUAL, 0): (VELOCITY, 32, 1, False, True),
    (od.TARGET_TORQUE, 0): (TARGET_TORQUE, 16, 1, True, True),
    (od.MAX_TORQUE, 0): (MAX_TORQUE, 16, 0, True, True),
    (od.TORQUE_ACTUAL, 0): (TORQUE_ACTUAL, 16, 1, False, True),
    (0x0002, 0): (DUMMY, 8, 0, True, False),
    (0x0003, 0): (DUMMY, 16, 0, True, False),
    (0x0004, 0): (DUMMY, 32, 0, True, False),
    (0x0005, 0): (DUMMY, 8, 0, True, False),
    (0x0006, 0): (DUMMY, 16, 0, True, False),
    (0x0007, 0): (DUMMY, 32, 0, True, False),
}

LIVE: Final = {
    # further objects that SDO reads and writes in the matrix rather than in its store
    (od.QUICK_STOP_OPTION, 0): (QUICK_STOP_OPTION, 16, 1),
    (od.FAULT_REACTION_OPTION, 0): (FAULT_OPTION, 16, 1),
    (od.ABORT_CONNECTION_OPTION, 0): (ABORT_OPTION, 16, 1),
    **{key: row[:3] for key, row in MAPPABLE.items() if key[0] > 0x1000},
}
