"""What the executor needs of a control law, and the status bits a cycle may return."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

F64: TypeAlias = NDArray[np.float64]
"""A float64 array."""

InverseDynamics: TypeAlias = Callable[[F64, F64, F64], F64]
"""(q, v, a) in rad, rad/s, rad/s² to torque in Nm, (n,) each."""

Struct: TypeAlias = NDArray[Any]
"""A structured array, one record per joint (see :mod:`dftc_rt.control.layout`)."""

OK: Final = 0
NONFINITE_INPUT: Final = 1
"""A measurement, reference, inertia or bias was NaN, infinite or (inertia) not positive."""
NONFINITE_LAW: Final = 2
"""The law or an estimator left the finite numbers; the command sent was 0 Nm."""

WANTS_RESPONSE: Final = 4
"""Inside the law ``dftc`` only: a joint asks for the response that its test torque will meet."""

STATUS: Final = {NONFINITE_INPUT: "non-finite input", NONFINITE_LAW: "non-finite law"}


class Law(Protocol):
    """One control law for all joints, stepped once per cycle.

    Attributes:
        uses_local_terms: True when the caller must fill ``inertia`` and ``bias`` each cycle.
        ftc: True when the self-tuned gain (33) is applied; False leaves the law untouched
            but still estimates.
    """

    @property
    def uses_local_terms(self) -> bool:
        """Whether ``inertia`` and ``bias`` are read."""
        ...

    @property
    def ftc(self) -> bool:
        """Whether the estimate acts on the command."""
        ...

    def start(self, q: F64, v: F64) -> None:
        """Reset every state; called once, at rest, before the first cycle.

        Args:
            q: Measured positions, (n,), rad.
            v: Measured velocities, (n,), rad/s.

        Raises:
            InputError: A shape is wrong or a value is not finite.
        """
        ...

    def skip(self, ticks: int) -> None:
        """Let ticks pass without a cycle or SYNC: the torque in force stays. Real-time safe."""
        ...

    def told(self, joint: int, tau: float) -> None:
        """Take a joint's last command to have been another one; of a replay, never of the loop.

        Args:
            joint: Its index.
            tau: Torque that its drive was told, Nm.
        """
        ...

    def update(self, rec: F64, inertia: F64, bias: F64, load: F64 | None = None) -> int:
        """Compute one cycle; real-time safe after the first call (which compiles).

        Args:
            rec: Record of this cycle, (15, n), rows of :mod:`dftc_rt.control.signals`; rows
                Q to AD and AGE are read, the others written.
            inertia: M_i, (n,), kg m².
            bias: Torque needed besides M_i q̈_i, (n,), Nm.
            load: Torque that one more kilogram at the last link needs, (n,), Nm/kg; None: no
                joint knows, and a payload cannot be told from a disturbance.

        Returns:
            0, or an or of the status bits of this module.
        """
        ...
