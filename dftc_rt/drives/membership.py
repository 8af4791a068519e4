"""Which joints are on which bus, and which of them have answered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dftc_rt.drives.interface import DriveConfig
from dftc_rt.errors import InputError

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]


def node_ids(drives: Sequence[DriveConfig]) -> I64:
    """Return the node ids, (n,)."""
    return np.array([drive.node_id for drive in drives], dtype=np.int64)


def members_by_bus(drives: Sequence[DriveConfig], buses: int) -> list[I64]:
    """Return the joints of each bus, (m,) each, in joint order.

    Raises:
        InputError: Two drives of a bus share a node id.
    """
    members = [
        np.array([i for i, drive in enumerate(drives) if drive.bus == bus], dtype=np.int64)
        for bus in range(buses)
    ]
    for joints in members:
        ids = [drives[i].node_id for i in joints]
        if len(set(ids)) != len(ids):
            raise InputError("drives", f"node ids {ids} on one bus", "all different")
    return members


def node_lookup(members: I64, ids: I64, size: int) -> I32:
    """Return node id -> joint (-1: none on this bus), (size,).

    Args:
        members: Joints on this bus, (m,).
        ids: Node ids of all joints, (n,).
        size: One more than the largest node id that a frame can name.
    """
    lookup = np.full(size, -1, dtype=np.int32)
    lookup[ids[members]] = members
    return lookup


def refuse_shared_nodes(drives: Sequence[DriveConfig], buses: Sequence[str]) -> None:
    """Refuse two drives with one node id on a bus.

    Args:
        drives: The drives.
        buses: Names of the buses.

    Raises:
        InputError: There are two; names the joint of the second, and the bus.
    """
    taken: set[tuple[int, int]] = set()
    for drive in drives:
        if (drive.bus, drive.node_id) in taken:
            what = f"node id {drive.node_id} is taken on {buses[drive.bus]}"
            raise InputError(drive.scale.joint, what)
        taken.add((drive.bus, drive.node_id))


@njit(cache=True)
def missing(seen: I64, members: I64) -> int:
    """Return how many of the members have bit 0 of ``seen`` clear: no feedback this cycle."""
    count = 0
    for k in range(members.shape[0]):
        if seen[members[k]] & 1 == 0:
            count += 1
    return count
