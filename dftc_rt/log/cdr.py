"""The standard ROS 2 messages of a log, and one of our own, in CDR.

CDR aligns each number to its size, counted from the end of the 4-byte encapsulation
header; a string is its length with the final NUL, the bytes and the NUL. See OMG
DDS-RTPS 10.2 and the ``PLAIN_CDR`` encoding of DDS-XTypes 7.4.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from dftc_rt.log.schema import CDR_HEADER

_RULE: Final = "=" * 80 + "\n"
_TIME: Final = _RULE + "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_HEADER: Final = (
    _RULE + "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n" + _TIME
)

EVENT_DEFINITION: Final = (
    "float64 t  # s, run time\n"
    "uint8 severity  # 0 debug, 1 info, 2 warning, 3 error\n"
    "string source\n"
    "string text\n"
)
STRING_DEFINITION: Final = "string data\n"
JOINT_STATE_DEFINITION: Final = (
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
    "float64[] effort\n" + _HEADER
)
TF_DEFINITION: Final = (
    "geometry_msgs/TransformStamped[] transforms\n"
    + _RULE
    + "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\n"
    "string child_frame_id\ngeometry_msgs/Transform transform\n"
    + _RULE
    + "MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation\n"
    + _RULE
    + "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
    + _RULE
    + "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    + _HEADER
)

Frame = tuple[str, str, Sequence[float], Sequence[float]]
"""Parent, child, translation (3,) in m, rotation (4,) as x, y, z, w."""


class _Writer:
    def __init__(self) -> None:
        self._out = bytearray(CDR_HEADER)

    def _align(self, size: int) -> None:
        self._out += b"\0" * (-(len(self._out) - 4) % size)

    def number(self, code: str, value: float) -> Self:
        self._align(struct.calcsize("<" + code))
        self._out += struct.pack("<" + code, value)
        return self

    def string(self, text: str) -> Self:
        raw = text.encode() + b"\0"
        self.number("I", len(raw))
        self._out += raw
        return self

    def stamp(self, time_ns: int, frame: str) -> Self:
        sec, nanosec = divmod(time_ns, 1_000_000_000)
        return self.number("i", sec).number("I", nanosec).string(frame)

    def floats(self, values: Sequence[float] | NDArray[np.float64]) -> Self:
        self._align(8)
        self._out += np.asarray(values, "<f8").tobytes()
        return self

    def array(self, values: NDArray[np.float64]) -> Self:
        return self.number("I", len(values)).floats(values)

    def done(self) -> bytes:
        return bytes(self._out)


def encode_event(t: float, severity: int, source: str, text: str) -> bytes:
    """``dftc_rt/msg/Event``; ``t`` in s."""
    return _Writer().number("d", t).number("B", severity).string(source).string(text).done()


def decode_event(payload: bytes) -> tuple[float, int, str, str]:
    """Inverse of :func:`encode_event`: t in s, severity, source, text."""
    t, severity = struct.unpack_from("<dB", payload, 4)
    at = 16
    (length,) = struct.unpack_from("<I", payload, at)
    source = payload[at + 4 : at + 3 + length].decode()
    at += 4 + length
    at += -(at - 4) % 4
    (length,) = struct.unpack_from("<I", payload, at)
    return t, severity, source, payload[at + 4 : at + 3 + length].decode()


def encode_string(text: str) -> bytes:
    """``std_msgs/msg/String``."""
    return _Writer().string(text).done()


def encode_joint_state(
    time_ns: int,
    joints: Sequence[str],
    q: NDArray[np.float64],
    v: NDArray[np.float64],
    tau: NDArray[np.float64],
) -> bytes:
    """``sensor_msgs/msg/JointState``.

    Args:
        time_ns: Stamp, ns.
        joints: Names, n of them.
        q: Positions, shape (n,), rad.
        v: Velocities, shape (n,), rad/s.
        tau: Torques, shape (n,), Nm.
    """
    out = _Writer().stamp(time_ns, "").number("I", len(joints))
    for joint in joints:
        out.string(joint)
    return out.array(q).array(v).array(tau).done()


def encode_tf(time_ns: int, frames: Iterable[Frame]) -> bytes:
    """``tf2_msgs/msg/TFMessage`` with one transform per frame; the stamp in ns."""
    listed = list(frames)
    out = _Writer().number("I", len(listed))
    for parent, child, xyz, quaternion in listed:
        out.stamp(time_ns, parent).string(child).floats(xyz).floats(quaternion)
    return out.done()
