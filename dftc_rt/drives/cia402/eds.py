"""The EDS file, read once per node id."""

from __future__ import annotations

import functools

import canopen

from dftc_rt.drives.cia402.objects import EDS_PATH


@functools.cache
def dictionary(node_id: int) -> canopen.ObjectDictionary:
    """Return the object dictionary of a node; shared, so not to be changed.

    Args:
        node_id: Node id, which COB-IDs depend on.
    """
    return canopen.import_od(str(EDS_PATH), node_id)
