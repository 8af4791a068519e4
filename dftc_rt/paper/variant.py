"""What is simulated: one variant of an example's closed loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dftc_rt.paper.examples import Q0

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Fitted:
    """Networks f̂_o, ĝ_o fitted to fault-free data, for :data:`~observers.FITTED`.

    Attributes:
        centres: (n, m, 2), rad and rad/s, of networks that see x_i; (n, m, 5), further rad,
            rad/s and rad/s², of those that see the other joint's desired state as well.
        inv_width: (n, 2) or (n, 5), inverse units.
        w_f: (n, m), rad/s².
        w_g: (n, m), 1/(kg m²).
        interconnection: Add the interconnection of the split at `desired`, against `frozen`,
            to f̂_o and ĝ_o.
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


Act = Literal["on", "held", "removed"]
"""What becomes of an adaptive quantity under the fault."""


@dataclass(frozen=True)
class Reading:
    """How single equations and initial values are read, where no setting covers it.

    The default is the printed text; the others are for :mod:`dftc_rt.paper.search`.

    Attributes:
        delta: What becomes of δ̂ under the fault; None: as :attr:`Variant.robust` says.
        xi: The same of ξ̂.
        networks: The same of Ŵ_f, Ŵ_g; ``removed`` means ``held``.
        known: f̂, ĝ in (10) are those of the split at `desired`, not of networks.
        error13: |e| in the place of |s| in (13).
        applied12: u as applied in (12).
        sgn18: sgn(e_2o) is in (18).
        delivered18: The identifier and its copies are told ρ u.
        both: The fault hits joint 2 as well.
        limit_nm: Torque at which the actuators saturate, Nm.
        q0: Initial positions, rad.
        rho0: ρ̂ at the start.
        weights_seed: Seed of random initial weights, uniform in ±0.5; None: the printed ones.
        motion: Reference as arguments of :func:`dftc_rt.reference.sines` between t and out;
            None: the example's.
    """

    delta: Act | None = None
    xi: Act | None = None
    networks: Act | None = None
    known: bool = False
    error13: bool = False
    applied12: bool = False
    sgn18: bool = True
    delivered18: bool = False
    both: bool = False
    limit_nm: float = float("inf")
    q0: tuple[float, float] = Q0
    rho0: float = 1.0
    weights_seed: int | None = None
    motion: tuple[F64, F64, F64, F64] | None = None


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
        reading: How single equations and initial values are read.
    """

    example: int
    epsilon: float = 0.01
    fault: bool = True
    gain: str = "none"
    robust: Act = "on"
    identifier: Literal["adapt", "frozen"] = "frozen"
    plant: str | None = None
    gains: dict[str, Any] = field(default_factory=dict)
    fitted: Fitted = field(default_factory=Fitted.none)
    reading: Reading = field(default_factory=Reading)
