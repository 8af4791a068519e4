"""The EDS file, read once per node id."""

from __future__ import annotations

import functools

import canopen

from dftc_rt.drives.cia402.objects import EDS_PATH
from dftc_rt.errors import EnvironmentLacksError, plain


@functools.cache
def dictionary(node_id: int) -> canopen.ObjectDictionary:
    """Return the object dictionary of a node; shared, so not to be changed.

    Args:
        node_id: Node id, which COB-IDs depend on.

    Raises:
        EnvironmentLacksError: The file, which is a part of this package, is missing or damaged.
    """
    try:
        return canopen.import_od(str(EDS_PATH), node_id)
    except Exception as error:  # of a parser in canopen, whatever it comes across
        what = f"{EDS_PATH.name} of the drive profile is missing or damaged: {plain(error)}"
        raise EnvironmentLacksError(what, "install dftc_rt again") from None
