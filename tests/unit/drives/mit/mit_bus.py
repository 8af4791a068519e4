"""Emulated MIT drives behind a FrameSocket, and robots of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dftc_rt.drives.interface import DriveConfig
from dftc_rt.drives.mit.scale import MitScale
from hil.drive.mit import MitDrives
from hil.drive.spec import DriveSpec


def scales(n: int, **changes: Any) -> list[MitScale]:
    """Return n drives with the published ranges: ±12.5 rad, ±45 rad/s, ±18 Nm."""
    sheet = {
        "counts_per_rev": 1 << 20, "rated_torque_nm": 6.0, "max_torque_nm": 18.0,
        "p_max": 12.5, "v_max": 45.0, "t_max": 18.0, "kp_max": 500.0, "kd_max": 5.0,
        "lower": -12.0, "upper": 12.0,
    }  # fmt: skip
    return [MitScale(joint=f"joint{i + 1}", **(sheet | changes)) for i in range(n)]


def drives_of(sheets: Sequence[MitScale], per_bus: int = 3, watchdog_s: float = 0.0) -> MitDrives:
    """Return emulated drives with node ids 1, 2, … spread over buses."""
    specs = [DriveSpec(i + 1, i // per_bus, s, watchdog_s) for i, s in enumerate(sheets)]
    return MitDrives(specs, buses=(len(specs) - 1) // per_bus + 1)


def configs(sheets: Sequence[MitScale], per_bus: int = 3) -> list[DriveConfig]:
    """Return what the controller knows of the same drives."""
    return [DriveConfig(i + 1, i // per_bus, s) for i, s in enumerate(sheets)]
