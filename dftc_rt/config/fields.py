"""Types of fields that the tables of a scenario share."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Scalars = float | tuple[float, ...]  # one value for all joints, or one per joint
Magnitudes = NonNegative | tuple[NonNegative, ...]  # the same, none negative
Positives = Positive | tuple[Positive, ...]  # the same, all above 0
AtLeastOne = Annotated[float, Meta(ge=1)]
Deflection = Annotated[float, Meta(ge=1e-9)]
Seed = Annotated[int, Meta(ge=0)]


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every table: immutable, unknown keys refused."""
