"""Identifiers and object indices of CANopen and CiA 402 that both ends use.

Source: CiA 301 (pre-defined connection set, communication profile area) and
CiA 402-2 (drive profile area).
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

EDS_PATH: Final = Path(__file__).with_name("dftc402.eds")

# Pre-defined connection set: identifier = base + node id.
NMT: Final = 0x000
SYNC: Final = 0x080
EMCY: Final = 0x080
TPDO: Final = (0x180, 0x280, 0x380, 0x480)
RPDO: Final = (0x200, 0x300, 0x400, 0x500)
SDO_RESPONSE: Final = 0x580
SDO_REQUEST: Final = 0x600
HEARTBEAT: Final = 0x700

NMT_START: Final = 1
NMT_STOP: Final = 2
NMT_PRE_OPERATIONAL: Final = 128
NMT_RESET_NODE: Final = 129
NMT_RESET_COMMUNICATION: Final = 130

BOOT_UP: Final = 0
STOPPED: Final = 4
OPERATIONAL: Final = 5
PRE_OPERATIONAL: Final = 127

# Communication profile area.
DEVICE_TYPE: Final = 0x1000
ERROR_REGISTER: Final = 0x1001
ERROR_HISTORY: Final = 0x1003
SYNC_COB_ID: Final = 0x1005
SYNC_PERIOD: Final = 0x1006
EMCY_COB_ID: Final = 0x1014
HEARTBEAT_CONSUMER: Final = 0x1016
HEARTBEAT_PRODUCER: Final = 0x1017
IDENTITY: Final = 0x1018
SYNC_OVERFLOW: Final = 0x1019
ERROR_BEHAVIOUR: Final = 0x1029
RPDO_COMMUNICATION: Final = 0x1400
RPDO_MAPPING: Final = 0x1600
TPDO_COMMUNICATION: Final = 0x1800
TPDO_MAPPING: Final = 0x1A00

# Drive profile area.
ABORT_CONNECTION_OPTION: Final = 0x6007
ERROR_CODE: Final = 0x603F
CONTROLWORD: Final = 0x6040
STATUSWORD: Final = 0x6041
QUICK_STOP_OPTION: Final = 0x605A
FAULT_REACTION_OPTION: Final = 0x605E
MODE: Final = 0x6060
MODE_DISPLAY: Final = 0x6061
POSITION_ACTUAL: Final = 0x6064
VELOCITY_ACTUAL: Final = 0x606C
TARGET_TORQUE: Final = 0x6071
MAX_TORQUE: Final = 0x6072
RATED_TORQUE: Final = 0x6076
TORQUE_ACTUAL: Final = 0x6077
MAX_MOTOR_SPEED: Final = 0x6080
ENCODER_RESOLUTION: Final = 0x608F
GEAR_RATIO: Final = 0x6091
INTERPOLATION_PERIOD: Final = 0x60C2
SUPPORTED_MODES: Final = 0x6502

DEVICE_PROFILE: Final = 402  # low word of object 1000h
CST: Final = 10  # cyclic synchronous torque
CST_SUPPORTED: Final = 1 << 9  # its bit in object 6502h

# Communication-loss reaction, object 6007h.
ABORT_FAULT: Final = 1

# EMCY error codes (CiA 301, CiA 402-2).
EMCY_RESET: Final = 0x0000
EMCY_COMMUNICATION: Final = 0x8100
EMCY_HEARTBEAT_LOST: Final = 0x8130
EMCY_PDO_LENGTH: Final = 0x8210
EMCY_RPDO_TIMEOUT: Final = 0x8250

# SYNC counter overflow that our set-up uses: 240 is a multiple of every slow type below.
SYNC_COUNTER_OVERFLOW: Final = 240
TORQUE_ACTUAL_EVERY: Final = 10  # TPDO3 comes with every 10th SYNC, one node after the other
STATUS_INHIBIT_100US: Final = 100  # TPDO2 at most every 10 ms
MASTER_NODE_ID: Final = 127  # producer of the heartbeat that drives listen to
MASTER_HEARTBEAT_MS: Final = 50  # how often it comes; drives wait three times as long
