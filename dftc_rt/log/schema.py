"""What a record is: a flat float64 array whose CDR encoding is itself.

A ROS 2 message that has only ``float64`` fields is, in CDR (little-endian, no padding
between 8-byte fields), the encapsulation header ``00 01 00 00`` and then the numbers. So
a record is logged as it lies in memory, and read back with ``frombuffer``.

    /cycle   t lateness compute exchange state overruns skipped | rows x joints   (controller)
    /rig     t                                                  | rows x joints   (rig)
    /can     t, then the frame: CanLayout                        (controller, with --frames)

The per-joint part is a C-ordered matrix ``(rows, n)``: field-major, ``q_<joint 1> ...
q_<joint n>, v_<joint 1> ...``.

ROS 2 allows field names of lower-case letters, digits and single underscores that do not
end in one (https://design.ros2.org/articles/legacy_interface_definition.html). Joint names
of real robots break each of these (``LF_HAA``, ``a__b``). Such a log is written all the
same, and viewers take any identifier; rosidl, and with it the Python package
mcap-ros2-support, refuses the definition.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from dftc_rt.bus.frame_record import record_words
from dftc_rt.errors import InputError

SCENARIO: Final = "scenario.toml"
URDF: Final = "robot.urdf"
"""Names of the attachments that every log has."""

CDR_HEADER: Final = b"\x00\x01\x00\x00"  # CDR, little-endian, no options
CYCLE_HEADER: Final = (
    "t", "lateness", "compute", "exchange", "state", "overruns", "skipped",
)  # fmt: skip
RIG_HEADER: Final = ("t",)
RIG_ROWS: Final = ("q", "v", "tau_applied", "rho", "fault", "cmd_age")

_UNITS: Final = {
    "t": "s, scheduled time of the cycle",
    "lateness": "s, wake-up after the scheduled time",
    "compute": "s, time of the update",
    "exchange": "s, time of the bus exchange",
    "state": "state of the executor",
    "overruns": "late ticks so far",
    "skipped": "ticks left out so far",
    "q": "rad (m for a prismatic joint)",
    "v": "rad/s",
    "qd": "rad, desired",
    "vd": "rad/s, desired",
    "ad": "rad/s^2, desired",
    "tau_law": "Nm, of the law, before the gain",
    "tau_cmd": "Nm, as sent",
    "tau_applied": "Nm, applied",
    "rho": "effectiveness, true",
    "rho_hat": "effectiveness, estimated",
    "rho_std": "its standard deviation",
    "observable": "1 while rho can be observed",
    "verdict": "0 healthy, 1 loss, 2 payload, 3 disturbance, 4 not observable, 5 sensor, "
    "6 unknown, 7 anomaly",
    "s": "rad/s, sliding variable",
    "residual": "Nm",
    "age": "cycles, of the measurement",
    "status": "CiA 402 statusword of the drive",
    "fault": "1 while a fault acts on the joint",
    "cmd_age": "cycles since the actuated command was sent",
}


@dataclass(frozen=True)
class Layout:
    """Where each number of a record is.

    Attributes:
        topic: MCAP topic.
        schema: ROS 2 type name.
        header: Names of the leading scalars; the first is ``t`` in s.
        rows: Names of the per-joint rows.
        joints: Joint names as the robot has them, in order.
    """

    topic: str
    schema: str
    header: tuple[str, ...]
    rows: tuple[str, ...]
    joints: tuple[str, ...]

    @property
    def size(self) -> int:
        """Float64 per record."""
        return len(self.header) + len(self.rows) * len(self.joints)

    @property
    def fields(self) -> tuple[str, ...]:
        """Field names in the order of the record."""
        safe = [field_name(joint) for joint in self.joints]
        return self.header + tuple(f"{row}_{joint}" for row in self.rows for joint in safe)

    @property
    def definition(self) -> str:
        """The ``.msg`` text."""
        notes = [_UNITS.get(name, "") for name in self.header]
        notes += [_UNITS.get(row, "") for row in self.rows for _ in self.joints]
        lines = [
            f"float64 {name}" + (f"  # {note}" if note else "")
            for name, note in zip(self.fields, notes, strict=True)
        ]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class CanLayout:
    """What a record of ``/can`` is: :mod:`dftc_rt.bus.frame_record`.

    Attributes:
        buses: Logical bus names, by the index that a record has.
        data_bytes: Data bytes of a record: 8, or 64 where frames are CAN FD.
    """

    buses: tuple[str, ...]
    data_bytes: int
    topic: ClassVar[str] = "/can"
    schema: ClassVar[str] = "dftc_rt/msg/CanFrame"

    @property
    def size(self) -> int:
        """Float64 per record."""
        return record_words(self.data_bytes)

    @property
    def definition(self) -> str:
        """The ``.msg`` text."""
        buses = ", ".join(f"{i} {name}" for i, name in enumerate(self.buses))
        return (
            "float64 t  # s, run time at which the controller had sent or received it\n"
            "uint32 id  # with flags: 0x80000000 of 29 bits, 0x40000000 remote, 0x20000000 error\n"
            f"uint8 bus  # {buses}\n"
            "bool tx  # sent by the controller\n"
            "uint8 flags  # 4 CAN FD, 1 bit rate switched, 2 sender error passive\n"
            "uint8 length  # bytes of data that count\n"
            f"uint8[{self.data_bytes}] data\n"
        )


def field_name(joint: str) -> str:
    """Joint name as part of a field name: what is not in ``[A-Za-z0-9_]`` becomes ``_``."""
    return re.sub(r"[^A-Za-z0-9_]", "_", joint)


def cycle_layout(joints: Sequence[str], rows: Sequence[str]) -> Layout:
    """Layout of ``/cycle``.

    Args:
        joints: Joint names, in order.
        rows: Names of the rows of the controller's record matrix.

    Raises:
        InputError: Two fields would have the same name.
    """
    return _checked(Layout("/cycle", "dftc_rt/msg/Cycle", CYCLE_HEADER, tuple(rows), tuple(joints)))


def rig_layout(joints: Sequence[str]) -> Layout:
    """Layout of ``/rig``: what the rig knows and the controller never sees.

    Raises:
        InputError: Two fields would have the same name.
    """
    return _checked(Layout("/rig", "dftc_rt/msg/Rig", RIG_HEADER, RIG_ROWS, tuple(joints)))


def _checked(layout: Layout) -> Layout:
    if not layout.joints:
        raise InputError(layout.topic, "no joints", "at least one")
    origin: dict[str, str] = dict.fromkeys(layout.header, "the header")
    names = iter(layout.fields[len(layout.header) :])
    for row in layout.rows:
        for joint in layout.joints:
            field = next(names)
            if field in origin:
                raise InputError(
                    f"joint {joint!r}",
                    f"its field {field!r} of {layout.topic} clashes with {origin[field]}",
                    "joint names that differ in letters, digits or underscores",
                )
            origin[field] = f"{row} of joint {joint!r}"
    return layout
