"""Settings that are one number for all joints, or one for each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dftc_rt.errors import InputError

F64 = NDArray[np.float64]


def per_joint(value: float | tuple[float, ...], n: int, where: str) -> F64:
    """Return a scalar-or-list setting as (n,).

    Raises:
        InputError: The list has neither 1 nor n values.
    """
    values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if values.size not in (1, n):
        raise InputError(where, f"{values.size} values", f"1 or {n}, one per joint")
    return np.broadcast_to(values, (n,)).copy()
