"""What a figure of the paper shows, as a criterion on series.

| figure | shows | holds when |
|---|---|---|
| 1, 6 | joint 1 tracks without a fault | RMS error < :data:`TRACKS_RAD` from :data:`SETTLED_S` on |
| 2, 7 | it cannot follow under the fault | RMS error after the fault > :data:`LOST_RAD`, and at least :data:`LOST_RATIO` times that of the run without the fault over the same seconds |
| 5, 10 | it follows with the gain | RMS error after the fault < :data:`TRACKS_RAD` |
| 4, 9 | ρ̂_1 follows ρ_1 | RMS error of ρ̂_1 <= :data:`RHO_RMSE`, from :attr:`~dftc_rt.paper.examples.Example.settle_s` after the fault on |

"After the fault" begins one second after it: a jump of the torque moves the joint in any
closed loop.
"""  # noqa: E501

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

SETTLED_S: Final = 2.0
"""From here on a run without the fault is judged, s."""
AFTER_S: Final = 1.0
"""From this time after the fault on the tracking is judged, s."""
TRACKS_RAD: Final = 0.02
"""RMS error below which a joint tracks, rad."""
LOST_RAD: Final = 0.05
"""RMS error above which a joint cannot follow, rad."""
LOST_RATIO: Final = 10.0
"""And at least so many times the error of the run without the fault."""
RHO_RMSE: Final = 0.05
"""RMS error up to which ρ̂ follows ρ."""


def rms(values: F64) -> float:
    """Root mean square; infinite if a value is not finite, NaN of nothing."""
    if values.size == 0:
        return float("nan")
    with np.errstate(over="ignore"):
        level = float(np.sqrt(np.mean(np.square(values))))
    return level if np.isfinite(level) else float("inf")


def tracks(error_rms: float) -> bool:
    """Figures 1, 5, 6 and 10: the joint follows its reference.

    Args:
        error_rms: RMS tracking error, rad.
    """
    return bool(error_rms < TRACKS_RAD)


def cannot_follow(faulty_rms: float, healthy_rms: float) -> bool:
    """Figures 2 and 7: the fault, and nothing else, takes the tracking away.

    Args:
        faulty_rms: RMS tracking error after the fault, rad.
        healthy_rms: That of the same reading over the same seconds without the fault, rad.
    """
    healthy = math.isfinite(healthy_rms)
    return healthy and bool(faulty_rms > LOST_RAD and faulty_rms >= LOST_RATIO * healthy_rms)


def follows(rho_rmse: float) -> bool:
    """Figures 4 and 9: the estimate follows the effectiveness.

    Args:
        rho_rmse: RMS error of ρ̂_1.
    """
    return bool(rho_rmse <= RHO_RMSE)
