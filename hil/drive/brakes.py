"""Brakes of the joints: closed without power, open while a drive follows torque commands.

A drive that is told to stop, or loses its controller, holds the joint until its brake has
closed: to the arm it is closed at once. A drive that drops out (a fault of its own, no
supply), and one that knows no other stop than to let go, gives no torque any more, and
the brake takes its time.

Source: docs/safety.md.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from hil.drive import slots

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Mask = NDArray[np.bool_]

_POWERED: Final = -1.0
_ROUNDING_S: Final = 1e-9


@numba.njit(cache=True)
def _move(
    t: float, objects: I64, close_s: float, closed_at: F64, released: Mask, is_open: Mask
) -> bool:
    change = False
    for i in range(released.shape[0]):
        enabled = objects[i, slots.ENABLED] == 1
        if enabled:
            closed_at[i] = _POWERED
        elif closed_at[i] == _POWERED:
            closed_at[i] = t + close_s if objects[i, slots.LETS_GO] == 1 else t
        is_open[i] = enabled or t < closed_at[i] - _ROUNDING_S
        change = change or is_open[i] != released[i]
    return change


class Brakes:
    """When each brake is open.

    Attributes:
        is_open: As of the last :meth:`move`, (n,), bool.
    """

    def __init__(self, n: int, close_s: float) -> None:
        """Begin closed.

        Args:
            n: Number of joints.
            close_s: From the loss of power to a brake that holds, s.
        """
        self._close_s = close_s
        self._closed_at = np.zeros(n)  # rig time, s
        self.is_open = np.zeros(n, dtype=bool)

    def move(self, t: float, objects: I64, released: Mask) -> bool:
        """Bring ``is_open`` up to rig time ``t``, s; return whether some brake is to move.

        Args:
            t: Rig time, s; never less than before.
            objects: The drives, (n, N_OBJECTS).
            released: Brakes that are open now, (n,).
        """
        change: bool = _move(t, objects, self._close_s, self._closed_at, released, self.is_open)
        return change
