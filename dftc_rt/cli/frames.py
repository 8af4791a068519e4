"""The frames of a log, for the commands that need them."""

from __future__ import annotations

from typing import Any

from dftc_rt.bus.frame import EFF_FLAG, EFF_MASK, RTR_FLAG, SFF_MASK
from dftc_rt.errors import LogError
from dftc_rt.log.run import CanFrames, Run


def logged_frames(run: Run, where: str) -> CanFrames:
    """Return the frames of a run that was read with them.

    Raises:
        LogError: They were not recorded.
    """
    if run.can is None:
        raise LogError(where, "no topic /can", "a log that was recorded with --frames")
    return run.can


def spelled(record: Any) -> str:
    """Return a frame as people read it: identifier, then its data in hexadecimal.

    Args:
        record: One of :func:`dftc_rt.bus.frame_record.record_dtype`.
    """
    number = int(record["id"])
    wide = number & EFF_FLAG
    text = f"0x{number & EFF_MASK:08x}" if wide else f"0x{number & SFF_MASK:03x}"
    if number & RTR_FLAG:
        return f"{text} remote, {record['length']} bytes"
    data = record["data"][: record["length"]].tobytes()
    return f"{text} {data.hex(' ').upper() if data else 'no data'}"
