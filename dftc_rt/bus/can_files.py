"""Logged frames as the files of other CAN tools, through python-can's own writers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import can
import numpy as np

from dftc_rt.bus.frame import FD_FRAME_SIZE, FDF, RTR_FLAG
from dftc_rt.bus.frame_record import Records, frames_of
from dftc_rt.bus.python_can import to_message
from dftc_rt.errors import InputError

SUFFIXES: Final = {
    "candump": ".log",
    "asc": ".asc",
    "blf": ".blf",
    "trc": ".trc",
    "can-csv": ".csv",
    "txt": ".txt",
}
"""Format -> the ending by which python-can knows it. Its writer of .db is left out: a thread,
which forgets what waits when it is stopped.
"""

_NUMBERED: Final = ("asc", "blf", "trc")  # buses have numbers there, from 1
_NO_FD: Final = ("trc", "can-csv")  # the format, or python-can's writer of it, has no FD
_NO_REMOTE: Final = ("trc",)
_ROWS_AT_ONCE: Final = 65536


def check_frames(form: str, records: Records) -> None:
    """Refuse frames that would be left out of a file, or not be what they were.

    Args:
        form: One of :data:`SUFFIXES`.
        records: Every frame.

    Raises:
        InputError: CAN FD or remote frames in a format that has none.
    """
    others = ", ".join(name for name in ("candump", "asc", "blf") if name != form)
    if form in _NO_FD and (records["flags"] & FDF).any():
        raise InputError(f"--to {form}", "the log has CAN FD frames", others)
    if form in _NO_REMOTE and (records["id"] & np.uint32(RTR_FLAG)).any():
        raise InputError(f"--to {form}", "the log has remote frames", others)


def write_can_file(
    path: Path, form: str, records: Records, buses: Sequence[str], epoch_s: float
) -> None:
    """Write frames in the order in which they were logged.

    Args:
        path: File to write, with the ending of its format.
        form: One of :data:`SUFFIXES`.
        records: Every frame.
        buses: Logical bus names.
        epoch_s: Unix time of t = 0, s; no frame is written with a time before 1970.

    Raises:
        InputError: The format cannot hold what is in the log.
        OSError: The file cannot be written.
    """
    check_frames(form, records)
    channels = list(range(len(buses))) if form in _NUMBERED else list(buses)
    writer = can.Logger(path)
    try:
        for start in range(0, len(records), _ROWS_AT_ONCE):
            part = records[start : start + _ROWS_AT_ONCE]
            frames = frames_of(part, FD_FRAME_SIZE)
            times = np.maximum(part["t"] + epoch_s, 0.0).tolist()
            for row, (bus, tx) in enumerate(
                zip(part["bus"].tolist(), part["tx"].tolist(), strict=True)
            ):
                message = to_message(frames, row, channels[bus], times[row])
                message.is_rx = not tx
                writer(message)
    finally:
        writer.stop()
