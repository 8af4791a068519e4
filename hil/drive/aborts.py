"""SDO abort codes that the emulated drives answer with.

Source: CiA 301, "SDO abort codes".
"""

from typing import Final

UNSUPPORTED_ACCESS: Final = 0x0601_0000
NO_OBJECT: Final = 0x0602_0000
NOT_MAPPABLE: Final = 0x0604_0041
MAPPING_TOO_LONG: Final = 0x0604_0042
NO_SUBINDEX: Final = 0x0609_0011
INVALID_VALUE: Final = 0x0609_0030
VALUE_TOO_HIGH: Final = 0x0609_0031
VALUE_TOO_LOW: Final = 0x0609_0032
WRONG_STATE: Final = 0x0800_0022
NO_DATA: Final = 0x0800_0024
GENERAL: Final = 0x0800_0000
