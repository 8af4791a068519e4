"""The law in discrete time: which regularisations it needs to run at a fixed rate.

The law ``paper`` is run at fixed steps, as printed and with one regularisation after another,
then without each of them, in both examples: the controller alone (identifier and gain off), and
the whole. :mod:`dftc_rt.paper.discrete_cases` says what is run and where the values come from,
:mod:`dftc_rt.paper.discrete_loop` runs it.

Source: [zhao2017] eq. (1)-(33), section 5.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.config.scenario import ReferenceTable
from dftc_rt.control import laws
from dftc_rt.control.dftc import Dftc
from dftc_rt.paper.discrete_cases import Case, cases, scales
from dftc_rt.paper.discrete_loop import CHANGE_SUM, E_SUM, EVENTS, LOOP, PLANTS, RHO_SUM, arguments
from dftc_rt.paper.discrete_row import CHATTER, TRACKING_RAD, Outcome, Row
from dftc_rt.paper.discrete_table import table
from dftc_rt.paper.examples import EXAMPLES, Q0
from dftc_rt.reference import Reference

__all__ = ["Row", "Trace", "run", "study", "table", "to_json"]

F64 = NDArray[np.float64]

SAMPLE_S: Final = 0.01
"""Spacing of the samples of a trace, s; never below the control period."""

_BEFORE_S: Final = {1: 10.0, 2: 2.0}  # length of the window before the fault


@dataclass(frozen=True)
class Trace:
    """Samples of a run, up to where it diverged, K in number.

    Attributes:
        t: (K,), s.
        error: q - q_d, (K, 2), rad.
        torque: As told to the drives, (K, 2), Nm.
        bounds: δ̂ + ξ̂, (K, 2), rad/s².
        rho_hat: (K, 2).
    """

    t: F64
    error: F64
    torque: F64
    bounds: F64
    rho_hat: F64


def run(case: Case) -> tuple[Row, Trace]:
    """Run one case.

    Args:
        case: What to run.

    Raises:
        InputError: A setting is unknown or out of bounds.
    """
    example = EXAMPLES[case.example]
    h = case.step_s
    duration = case.duration_s or example.duration_s
    cycles = round(duration / h)
    law = laws.build(
        case.law, 2, h, case.limit(), np.zeros(2), 0, case.settings(), case.scope == "whole",
        np.full(2, -np.inf), np.full(2, np.inf), np.full(2, np.inf),
    )  # fmt: skip
    assert isinstance(law, Dftc)
    q, v = np.array(Q0), np.zeros(2)
    law.start(q, v)
    store = law.storage
    looked_at = (store.parameters, store.state, store.weights, store.centres, store.sigma)
    motion = Reference(ReferenceTable(kind=example.reference, blend_s=0.0), np.zeros(2)).harmonics
    windows = np.array(
        [
            [example.fault_s - _BEFORE_S[case.example], example.fault_s],
            [example.fault_s + example.settle_s, duration],
        ]
    )
    first = np.full((len(EVENTS), 2), np.inf)
    sums, counts, largest = np.zeros((2, 3, 2)), np.zeros((2, 2)), np.zeros(2)
    every = max(round(SAMPLE_S / h), 1)
    samples = np.zeros((cycles // every + 1, 4, 2))
    done = LOOP(
        PLANTS[example.plant], looked_at, arguments(store), law.uses_local_terms, h, cycles,
        case.substeps, motion, np.array([example.fault_s, *example.rho]), windows, q, v, first,
        sums, counts, largest, every, samples,
    )  # fmt: skip
    kept = samples[: (min(done, cycles - 1)) // every + 1]
    times: F64 = np.linspace(0.0, (len(kept) - 1) * every * h, len(kept))
    trace = Trace(times, kept[:, 0], kept[:, 1], kept[:, 2], kept[:, 3])
    ended = done * h
    rms: list[F64 | None] = [None, None]
    for n in range(2):
        if ended >= windows[n, 1] - 0.5 * h and counts[n].all():
            rms[n] = np.sqrt(sums[n] / counts[n])
    diverged = ended if done < cycles else None
    return _row(case, duration, diverged, first, rms, largest), trace


def _row(
    case: Case, duration: float, diverged: float | None, first: F64,
    rms: list[F64 | None], largest: F64,
) -> Row:  # fmt: skip
    """Judge a run."""
    limit = scales(case.example).limit
    reached = [r for r in rms if r is not None]
    outcome: Outcome = "runs"
    if diverged is not None:
        outcome = "diverges"
    elif any((r[CHANGE_SUM] > CHATTER * limit).any() for r in reached):
        outcome = "chatters"
    elif any((r[E_SUM] > TRACKING_RAD).any() for r in reached):
        outcome = "strays"
    n, i = np.unravel_index(int(first.argmin()), first.shape)
    settings = case.chosen()
    if "saturation" in case.on:
        settings["torque_limit"] = case.limit().tolist()
    change = np.max([r[CHANGE_SUM] for r in reached], axis=0) if reached else None
    before, after = rms
    return Row(
        case.group, case.example, case.scope, case.step_s, case.on, case.label, duration, outcome,
        diverged, f"{EVENTS[n]} of joint {i + 1}" if np.isfinite(first[n, i]) else None,
        None if before is None else _pair(before[E_SUM]),
        None if after is None else _pair(after[E_SUM]), _pair(largest),
        None if change is None else _pair(change),
        None if after is None else _pair(after[RHO_SUM]), settings,
    )  # fmt: skip


def _pair(values: F64) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def study(
    examples: Sequence[int] = (1, 2),
    progress: Callable[[int, int, Row], None] | None = None,
    *,
    quick: bool = False,
) -> list[Row]:
    """Run everything: 90 s of processor time, 15 s with ``quick``, on as many threads as cores.

    Args:
        examples: Which examples.
        progress: Called after each run with the number done, the number of all, and its row.
        quick: Steps of 1 ms only, and neither factors nor other readings.
    """
    todo = cases(examples, quick=quick)
    rows: list[Row] = []
    with ThreadPoolExecutor(max_workers=min(os.cpu_count() or 1, 8)) as pool:  # no GIL in LOOP
        for row, _ in pool.map(run, todo):
            rows.append(row)
            if progress is not None:
                progress(len(rows), len(todo), row)
    return rows


def to_json(rows: Sequence[Row]) -> str:
    """Return the rows as JSON: an object with the bounds of an outcome, and the rows."""
    bounds = {"tracking_rad": TRACKING_RAD, "chatter": CHATTER}
    listed = [asdict(row) for row in rows]
    return (
        json.dumps(
            {"bounds": bounds, "rows": listed}, indent=1, ensure_ascii=False, allow_nan=False
        )
        + "\n"
    )
