"""Emulated moteus drives behind a FrameSocket, and robots of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dftc_rt.bus.frame import EFF_FLAG, FD_FRAME_SIZE, FD_LENGTHS
from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.moteus.scale import MoteusScale
from hil.drive.moteus import MoteusDrives
from hil.drive.spec import DriveSpec
from tests.unit.drives.drive_bus import DriveBus


def scales(n: int, **changes: Any) -> list[MoteusScale]:
    """Return n drives: 2^20 counts a turn, 18 Nm, ±12 rad."""
    sheet = {
        "counts_per_rev": 1 << 20, "rated_torque_nm": 6.0, "max_torque_nm": 18.0,
        "lower": -12.0, "upper": 12.0,
    }  # fmt: skip
    return [MoteusScale(joint=f"joint{i + 1}", **(sheet | changes)) for i in range(n)]


def drives_of(
    sheets: Sequence[MoteusScale], per_bus: int = 4, watchdog_s: float = 0.0
) -> MoteusDrives:
    """Return emulated drives with node ids 1, 2, … spread over buses."""
    specs = [DriveSpec(i + 1, i // per_bus, s, watchdog_s) for i, s in enumerate(sheets)]
    return MoteusDrives(specs, buses=(len(specs) - 1) // per_bus + 1)


def configs(sheets: Sequence[MoteusScale], per_bus: int = 4) -> list[DriveConfig]:
    """Return what the controller knows of the same drives."""
    return [DriveConfig(i + 1, i // per_bus, s) for i, s in enumerate(sheets)]


def bus_of(drives: MoteusDrives, bus: int = 0, wakes: bool = False) -> DriveBus:
    """Return one bus of them."""
    return DriveBus(drives, bus, wakes, FD_FRAME_SIZE)


def to(node: int, data: str, host: int = 0) -> tuple[int, bytes]:
    """Return a frame to a drive that asks for an answer: 8000h + host · 100h + node, and NOPs."""
    raw = bytes.fromhex(data)
    length = next(n for n in FD_LENGTHS if n >= len(raw))
    return EFF_FLAG | 0x8000 | host << 8 | node, raw.ljust(length, b"\x50")
