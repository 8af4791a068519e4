"""What an emulated drive is before it is powered on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dftc_rt.drives.scale import JointScale
from dftc_rt.errors import InputError


@dataclass(frozen=True, slots=True)
class DriveSpec:
    """One emulated drive.

    Attributes:
        node_id: Node id, 1 to 126.
        bus: Index of its bus.
        scale: Its data sheet.
        watchdog_s: Longest time between RPDOs while enabled, s of rig time; 0: none.
            Object 1400h:05h, when written, takes its place.
    """

    node_id: int
    bus: int
    scale: JointScale
    watchdog_s: float = 0.0


def members_of(specs: Sequence[DriveSpec], buses: int) -> list[NDArray[np.int64]]:
    """Return the drives of each bus in the order of their node ids.

    Raises:
        InputError: A node id or a bus is out of range or taken.
    """
    taken: set[tuple[int, int]] = set()
    for spec in specs:
        where = f"drive of {spec.scale.joint}"
        if not 1 <= spec.node_id <= 126:
            raise InputError(where, f"node id {spec.node_id}", "1 to 126")
        if not 0 <= spec.bus < buses:
            raise InputError(where, f"bus {spec.bus}", f"0 to {buses - 1}")
        if (spec.bus, spec.node_id) in taken:
            raise InputError(where, f"node id {spec.node_id} is taken on bus {spec.bus}")
        taken.add((spec.bus, spec.node_id))
    order = sorted(range(len(specs)), key=lambda d: specs[d].node_id)
    return [
        np.array([d for d in order if specs[d].bus == bus], dtype=np.int64) for bus in range(buses)
    ]
