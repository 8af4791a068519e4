"""The EDS file, read once per node id."""

from __future__ import annotations

import functools
import hashlib
from typing import Final

import canopen

from dftc_rt.drives.cia402.objects import EDS_PATH
from dftc_rt.errors import EnvironmentLacksError, plain

# Of the file that belongs to these sources. An object that is lost, or whose type has changed,
# would otherwise show wherever somebody asks for it, in the rig or in set-up.
EDS_DIGEST: Final = "79f85d0b0aa9ec6aa04cadd6125d0b30acfc189c82eb3e766eac0c85cc98aa84"


@functools.cache
def dictionary(node_id: int) -> canopen.ObjectDictionary:
    """Return the object dictionary of a node; shared, so not to be changed.

    Args:
        node_id: Node id, which COB-IDs depend on.

    Raises:
        EnvironmentLacksError: The file, which is a part of this package, is missing or damaged.
    """
    try:
        found = hashlib.sha256(EDS_PATH.read_bytes()).hexdigest()
    except OSError as error:
        what = f"{EDS_PATH.name} of the drive profile cannot be read: {plain(error)}"
        raise EnvironmentLacksError(what, "install dftc_rt again") from None
    if found != EDS_DIGEST:
        what = f"{EDS_PATH.name} of the drive profile is not the file that belongs to it"
        raise EnvironmentLacksError(what, "install dftc_rt again")
    return canopen.import_od(str(EDS_PATH), node_id)
