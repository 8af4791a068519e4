"""What the fitted observer reaches with each form of networks and each kind of data.

Source: [zhao2017] Fig. 4, 9.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.paper.closed_loop import Solution, solve
from dftc_rt.paper.fit import (
    HELD_OUT_SEED,
    Form,
    Samples,
    diagnosed,
    own_data,
    residual,
    rich_data,
)
from dftc_rt.paper.observers import READINGS
from dftc_rt.paper.variant import Variant

F64 = NDArray[np.float64]

_FITTED: Final = tuple(reading for reading in READINGS if reading.name == "fitted")
_FORMS: Final[tuple[tuple[Form, str], ...]] = (
    ("desired", "x_i and the other joint's desired state"),
    ("split", "x_i, and the interconnection of the split at `desired`"),
    ("local", "x_i alone"),
)


@dataclass(frozen=True)
class FitRow:
    """One fit, of joint 1.

    Attributes:
        example: 1 or 2.
        networks: What they see.
        data: ``rich``, or ``own run``: the paper's, up to the fault.
        condition: Condition number of the scaled columns.
        ridged: The same with the ridge.
        excitation: Share of the variance of u that σ(x) does not explain.
        residual: RMS residual on the data, rad/s².
        held_out: The same on a rich motion that was not fitted.
        rho_rmse: RMS error of ρ̂_1 on the judged run, from
            :attr:`~dftc_rt.paper.examples.Example.settle_s` after the fault on.
    """

    example: int
    networks: str
    data: str
    condition: float
    ridged: float
    excitation: float
    residual: float
    held_out: float
    rho_rmse: float


def compare(example: int) -> list[FitRow]:
    """Fit every form to rich data, and the first to the paper's own run; judge each.

    Args:
        example: 1 or 2.

    Raises:
        InputError: No such example.
    """
    rich, unseen = rich_data(example), rich_data(example, HELD_OUT_SEED)
    own = own_data(solve(Variant(example), readings=_FITTED))
    rows = [_row(form, words, "rich", rich, unseen) for form, words in _FORMS]
    return [*rows, _row(*_FORMS[0], "own run", own, unseen)]


def _row(form: Form, words: str, data: str, samples: Samples, unseen: Samples) -> FitRow:
    fitted, (found, _) = diagnosed(samples.example, form, samples)
    judged = solve(Variant(samples.example, fitted=fitted), readings=_FITTED)
    return FitRow(
        samples.example, words, data, found.condition, found.ridged, found.excitation,
        found.residual, _rms(residual(fitted, unseen, 0)), _rho_rmse(judged),
    )  # fmt: skip


def _rho_rmse(found: Solution) -> float:
    late = found.window(found.example.fault_s + found.example.settle_s)
    return _rms(found.rho_hat[late, 0, 0] - found.rho[late])


def _rms(values: F64) -> float:
    return float(np.sqrt(np.mean(values**2)))


def table(rows: Iterable[FitRow]) -> str:
    """Return the rows as a Markdown table."""
    lines = [
        "| example | networks see | data | condition | with ridge | excitation "
        "| residual, rad/s² | held out, rad/s² | RMSE of ρ̂_1 |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        numbers = (
            row.condition, row.ridged, row.excitation, row.residual, row.held_out, row.rho_rmse,
        )  # fmt: skip
        cells = [str(row.example), row.networks, row.data, *(f"{n:.2g}" for n in numbers)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def to_json(rows: Iterable[FitRow]) -> str:
    """Return the rows as JSON."""
    return json.dumps([asdict(row) for row in rows], ensure_ascii=False, indent=1) + "\n"
