"""Readings of the effectiveness observer (27)-(29) that are simulated side by side.

They differ in what is compared with the observer, in whether the identifier's correction
terms are inside, in where f̂_o and ĝ_o come from, and in the normalisation of (29). All read
the same loop; at most one of them drives the gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

IDENTIFIER: Final = 0
"""f̂_o, ĝ_o from the identifier's networks, as printed."""
DESIRED: Final = 1
"""From the split, the other joint at its desired state."""
FROZEN: Final = 2
"""From the split, the other joint at rest in the upright."""
MEASURED: Final = 3
"""From the split, the other joint at its true state."""
FITTED: Final = 4
"""From networks fitted to rich fault-free data."""


@dataclass(frozen=True)
class ObserverReading:
    """One reading of (27)-(29).

    Attributes:
        name: Key in tables and series.
        title: In words.
        true_rho: Compare with (27), which contains the true ρ; else with the measured state.
        correction: Keep the identifier's terms inside (28).
        models: Where f̂_o and ĝ_o come from: a constant of this module.
        normalised: Divide (29) by (ĝ u)², so that its speed does not depend on the torque.
        gamma_rho: Γ_ρ; 1/s² where normalised. None: as printed.
        l2f: l_2f, 1/s. None: as printed.
    """

    name: str
    title: str
    true_rho: bool
    correction: bool
    models: int
    normalised: bool
    gamma_rho: float | None = None
    l2f: float | None = None


_FAST: Final = {"gamma_rho": 1e6, "l2f": 2000.0}

READINGS: Final = (
    ObserverReading(
        "true_rho", "(27)-(29) as written: fed with the true ρ", True, True, IDENTIFIER, False
    ),
    ObserverReading(
        "measured", "(28), (29) as written, on measured signals", False, True, IDENTIFIER, False
    ),
    ObserverReading("desired", "ours: split at `desired`", False, False, DESIRED, True, **_FAST),
    ObserverReading("frozen", "ours: split at `frozen`", False, False, FROZEN, True, **_FAST),
    ObserverReading(
        "fitted", "ours: RBF networks fitted to rich data", False, False, FITTED, True, **_FAST
    ),
)
"""All of them, in the order of the rows of a solution."""
NAMES: Final = tuple(reading.name for reading in READINGS)
"""Their names."""
