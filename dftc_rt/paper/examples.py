"""The two examples of the paper: plants, references, faults, gains and initial values.

Source: [zhao2017] section 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Example:
    """One example.

    Attributes:
        number: 1 or 2.
        title: What it is.
        plant: Name of the closed-form plant.
        reference: Kind of the reference.
        duration_s: Length of the run, s.
        fault_s: When the fault of joint 1 begins, s.
        rho: ρ_1(t) = rho[0] + rho[1] cos(rho[2] t) from then on; the last in rad/s.
        settle_s: From this time after the fault on, ρ̂ is judged, s.
        w_f: Initial Ŵ_f of both joints, (7,); Ŵ_g starts equal.
        w_fo: Initial Ŵ_fo, (2, 7).
        w_go: Initial Ŵ_go, (2, 7).
    """

    number: int
    title: str
    plant: str
    reference: Literal["paper1", "paper2"]
    duration_s: float
    fault_s: float
    rho: tuple[float, float, float]
    settle_s: float
    w_f: tuple[float, ...]
    w_fo: tuple[tuple[float, ...], ...]
    w_go: tuple[tuple[float, ...], ...]

    def effectiveness(self, t: F64) -> F64:
        """Return the true ρ_1 at the times ``t`` (K,), s."""
        mean, amplitude, omega = self.rho
        faulty = mean + amplitude * np.cos(omega * t)
        return np.where(t >= self.fault_s, faulty, 1.0)


Q0: Final = (1.0, 1.0)
"""Initial positions, rad; the velocities are 0."""

IDENTIFIER_STATE: Final = (-1.0, 1.0)
"""Initial x̂_1o, rad, and x̂_2o, rad/s, of both joints; taken for x̂_f and x̂_fo as well."""

EXAMPLES: Final = {
    1: Example(
        number=1,
        title="parallel inverted pendulums joined by a hard spring",
        plant="pendulums",
        reference="paper1",
        duration_s=40.0,
        fault_s=20.0,
        rho=(0.8, 0.2, 3.0),
        settle_s=1.0,
        w_f=(2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0),
        w_fo=((-0.2, 0.3, -0.6, 0.5, -0.3, 0.4, -0.4), (-0.7, 0.1, -0.3, 0.6, 0.4, -0.1, 0.3)),
        w_go=((-0.4, 0.1, -0.1, -0.9, -0.3, 0.7, 0.5), (-0.3, 0.2, 0.6, -0.2, 0.8, 0.5, -0.4)),
    ),
    2: Example(
        number=2,
        title="2-DOF reconfigurable manipulator",
        plant="arm2",
        reference="paper2",
        duration_s=10.0,
        fault_s=4.0,
        rho=(0.8, 0.0, 0.0),
        settle_s=0.5,
        w_f=(1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 13.0),
        w_fo=((-0.5, 0.3, -0.9, 0.5, -0.3, -0.4, 0.4), (-0.7, 0.2, -0.5, -0.6, 0.4, 0.1, 0.9)),
        w_go=((0.4, 0.9, -0.7, -0.9, 0.7, -0.5, 0.8), (-0.3, 0.4, 0.9, 0.2, 0.8, 0.5, -0.2)),
    ),
}
"""By number."""
