"""What is simulated: one variant of an example's closed loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Fitted:
    """Networks f̂_o, ĝ_o fitted to fault-free data, for :data:`~observers.FITTED`.

    Attributes:
        centres: (n, m, 2), rad and rad/s.
        inv_width: (n, 2), 1/rad and s/rad.
        w_f: (n, m), rad/s².
        w_g: (n, m), 1/(kg m²).
        interconnection: Add the interconnection of the split at `desired` to f̂_o.
    """

    centres: F64
    inv_width: F64
    w_f: F64
    w_g: F64
    interconnection: bool

    @classmethod
    def none(cls) -> Fitted:
        """Networks of zeros: nothing was fitted."""
        zero = np.zeros((2, 1))
        return cls(np.zeros((2, 1, 2)), np.ones((2, 2)), zero, zero, False)


@dataclass(frozen=True)
class Variant:
    """What is simulated.

    Attributes:
        example: 1 or 2.
        epsilon: ε of tanh(s/ε), rad/s.
        fault: Whether the fault comes.
        gain: Name of the observer whose ρ̂ drives the gain (33); ``"none"``; or ``"true"``.
        robust: From the start of the fault on, δ̂ and ξ̂ go on adapting (``on``), keep their
            values (``held``) or are removed (``removed``, Remark 6); the networks Ŵ_f, Ŵ_g
            stop together with them.
        identifier: Whether the identifier goes on adapting under the fault.
        plant: Another closed-form plant than the example's.
        gains: Settings other than the printed ones, see docs/notation.md.
        fitted: Networks of the observer ``fitted``.
    """

    example: int
    epsilon: float = 0.01
    fault: bool = True
    gain: str = "none"
    robust: Literal["on", "held", "removed"] = "on"
    identifier: Literal["adapt", "frozen"] = "frozen"
    plant: str | None = None
    gains: dict[str, Any] = field(default_factory=dict)
    fitted: Fitted = field(default_factory=Fitted.none)
