"""Verdicts on the paper's figures, by stated rules.

A finding is a figure, a number for each variant, and a rule. The verdict follows from the
rule alone: a figure reproduces if the equations as printed meet it, and under a condition if
they meet it only in a variant that states one. What is ours is listed beside, and counts for
no verdict.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

REPRODUCES: Final = "reproduces"
CONDITIONAL: Final = "reproduces under a condition"
DOES_NOT: Final = "does not reproduce"

TRACKS_MRAD: Final = 10.0
"""Largest error with which a joint tracks, mrad: 1 % of the radian that it starts from zero,
about the width of a line in the figures."""
LOST_FACTOR: Final = 10.0
"""A joint cannot follow if its error is at least that much larger than without the fault."""
IDENTIFIED: Final = 0.01
"""Largest identification error, rad and rad/s: 1 % of that of ẋ at the start."""
FOLLOWS: Final = 0.02
"""Largest RMSE of ρ̂ with which it follows ρ: a tenth of the loss of 0.2."""
TARGETS: Final = {"desired": 0.005, "fitted": 0.02, "noise": 0.02}
"""RMSE of ρ̂_1 that our observer is to reach: noise-free with the split, noise-free with
networks fitted to rich data, and with noise at 1 kHz."""


@dataclass(frozen=True)
class Row:
    """One variant of a figure.

    Attributes:
        title: The variant in words.
        number: What the rule is about; None if it could not be measured.
        met: Whether the rule is met.
        printed: Whether it is the paper's equations, so that it counts for the verdict.
        conditions: What it takes beyond the equations as written; empty for the figure as
            claimed.
        detail: Further numbers, by name with unit.
    """

    title: str
    number: float | None
    met: bool
    printed: bool = True
    conditions: tuple[str, ...] = ()
    detail: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class Finding:
    """One figure.

    Attributes:
        figure: Its number in the paper.
        example: Number of the example.
        title: What it shows.
        claim: What the paper says it shows.
        quantity: What ``number`` of the rows is.
        unit: Its unit.
        rule: When the claim is met.
        rows: The figure as claimed first.
        remark: What a reader should know besides; "" if nothing.
    """

    figure: int
    example: int
    title: str
    claim: str
    quantity: str
    unit: str
    rule: str
    rows: Sequence[Row]
    remark: str = ""

    @property
    def verdict(self) -> str:
        """By the rule: see the head of this file."""
        printed = [row for row in self.rows if row.printed]
        if any(row.met and not row.conditions for row in printed):
            return REPRODUCES
        return CONDITIONAL if any(row.met for row in printed) else DOES_NOT

    @property
    def conditions(self) -> tuple[str, ...]:
        """Under each of which it reproduces, if only under conditions; the least of them."""
        if self.verdict != CONDITIONAL:
            return ()
        sets = [row.conditions for row in self.rows if row.printed and row.met]
        least = [one for one in sets if not any(set(other) < set(one) for other in sets)]
        return tuple(dict.fromkeys(", ".join(one) for one in least))


@dataclass(frozen=True)
class Target:
    """RMSE of our ρ̂_1 that is to be reached.

    Attributes:
        example: Number of the example.
        title: Which observer.
        number: RMSE; None if it was not measured.
        limit: To reach.
    """

    example: int
    title: str
    number: float | None
    limit: float

    @property
    def met(self) -> bool:
        """Whether it is reached."""
        return self.number is not None and self.number <= self.limit


@dataclass(frozen=True)
class Sampled:
    """What the product's own path measured: 1 kHz, CAN frames, encoder and velocity noise.

    Attributes:
        rho_rmse: RMSE of ρ̂_1 in the faulty time.
        rms_mrad: Tracking error of the joints there, RMS, (2,), mrad.
        largest_mrad: The same, largest magnitude.
        ending: How the run ended; after anything but ``done`` the numbers are NaN, because
            what was left of the faulty time says nothing of the rest.
    """

    rho_rmse: float
    rms_mrad: tuple[float, ...]
    largest_mrad: tuple[float, ...]
    ending: str

    def __post_init__(self) -> None:
        if self.ending != "done":
            nothing = (math.nan,) * len(self.rms_mrad)
            object.__setattr__(self, "rho_rmse", math.nan)
            object.__setattr__(self, "rms_mrad", nothing)
            object.__setattr__(self, "largest_mrad", nothing)


def known(number: float) -> float | None:
    """The number, or None for one that could not be measured."""
    return number if math.isfinite(number) else None


def per_joint(name: str, values: Sequence[float]) -> dict[str, float | None]:
    """Numbers of the joints, given in rad, in mrad."""
    return {f"{name} {i}/mrad": known(v * 1e3) for i, v in enumerate(values, start=1)}
