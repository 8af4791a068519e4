"""Where the other joints are put: the ``interconnection`` setting.

| setting | position | velocity | acceleration | known online to joint i |
|---|---|---|---|---|
| ``frozen`` | a reference configuration | 0 | 0 | yes |
| ``desired`` | desired | desired | desired | yes, stored before the run |
| ``measured`` | measured | measured | desired (none is measured) | no: a centralised reference |
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from dftc_rt.errors import InputError

Array = npt.NDArray[np.float64]
Interconnection = Literal["frozen", "desired", "measured"]
INTERCONNECTIONS: Final = ("frozen", "desired", "measured")


def surrogate(
    interconnection: Interconnection,
    frozen_q: Array,
    q: Array,
    v: Array,
    qd: Array,
    vd: Array,
    ad: Array,
) -> tuple[Array, Array, Array]:
    """State at which the other joints are put.

    Args:
        interconnection: The setting.
        frozen_q: (n,) reference configuration, rad.
        q: (n,) measured, rad.
        v: (n,) measured, rad/s.
        qd: (n,) desired, rad.
        vd: (n,) desired, rad/s.
        ad: (n,) desired, rad/s^2.

    Returns:
        Position, velocity, acceleration, each (n,).

    Raises:
        InputError: No such setting.
    """
    check_interconnection(interconnection)
    if interconnection == "frozen":
        return frozen_q, np.zeros_like(v), np.zeros_like(ad)
    if interconnection == "desired":
        return qd, vd, ad
    return q, v, ad


def check_interconnection(interconnection: str) -> None:
    """Refuse a setting that does not exist.

    Raises:
        InputError: No such setting.
    """
    if interconnection not in INTERCONNECTIONS:
        expected = "one of " + ", ".join(INTERCONNECTIONS)
        raise InputError("control.interconnection", f"found '{interconnection}'", expected)
