"""Does any reading of the paper reproduce its figures 2, 4 and 7?

Figures 2 and 7 show that joint 1 cannot follow under the fault without the gain, and 4 that
ρ̂_1 follows ρ_1. Neither comes out of the equations as printed. :func:`search` goes through
:func:`dftc_rt.paper.search_space.space` and holds every reading against the criteria of
:mod:`dftc_rt.paper.search_criteria`.

Each reading is integrated up to the fault once. One that does not track until then is left at
that. From there on it branches: without the fault; with the fault; and with the fault and the
gain of (33) from the observer as written. The branches end :data:`HORIZON_S` after the fault.
What is held or removed at the fault is so in the branch without the fault as well: what is
lost there is not lost to the fault.

Source: [zhao2017] section 5, Fig. 1, 2, 4-7, 9, 10.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.paper import search_criteria as criteria
from dftc_rt.paper.closed_loop import ClosedLoop
from dftc_rt.paper.observers import READINGS
from dftc_rt.paper.search_integrators import Stretch, integrate
from dftc_rt.paper.search_space import Candidate, space
from dftc_rt.pool import Task, run
from dftc_rt.reference import sines

F64 = NDArray[np.float64]

HORIZON_S: Final = 10.0
"""Longest stretch that is integrated after the fault, s."""

_OBSERVERS: Final = READINGS[:2]  # as written: on the true ρ, and on measured signals
_TRUE, _MEASURED = 0, 1
_FEW: Final = 8


@dataclass(frozen=True)
class Row:
    """What came of one reading of one example.

    RMS errors are infinite where the joint left, and NaN where nothing was simulated.

    Attributes:
        example: 1 or 2.
        group: What kind of reading it is.
        reading: The reading in words; the same in both examples.
        status: ``done``, or what ended which branch.
        healthy_rad: RMS error of joint 1 without the fault, from 2 s on, rad.
        after_rad: The same from 1 s after the time of the fault on, rad.
        bare_rad: With the fault and without the gain, over the same seconds, rad.
        gained_rad: With the fault and the gain from ρ̂ as written on the true ρ, rad.
        gained_measured_rad: The same on measured signals; simulated where that ρ̂ follows.
        rho_true_rmse: RMS error of ρ̂_1 as written, (27) fed with the true ρ: the smaller of
            that without the gain and that with it.
        rho_measured_rmse: The same on measured signals.
        tracks: Figure 1 or 6.
        cannot_follow: Figure 2 or 7.
        regains: Figure 5 or 10.
        rho_true: Figure 4 or 9, on the true ρ.
        rho_measured: Figure 4 or 9, on measured signals.
    """

    example: int
    group: str
    reading: str
    status: str
    healthy_rad: float
    after_rad: float
    bare_rad: float
    gained_rad: float
    gained_measured_rad: float
    rho_true_rmse: float
    rho_measured_rmse: float
    tracks: bool
    cannot_follow: bool
    regains: bool
    rho_true: bool
    rho_measured: bool

    @property
    def needs_gain(self) -> bool:
        """Whether figures 1, 2 and 5 (6, 7 and 10) hold together: what the paper claims."""
        return self.tracks and self.cannot_follow and self.regains


Progress = Callable[[int, int, str], None]
"""Called after each reading with how many are done, of how many, and its name."""


def search(
    progress: Progress | None = None, quick: bool = False, processes: int | None = None
) -> list[Row]:
    """Try every reading.

    Args:
        progress: Told of each reading that is done.
        quick: Only those of the tests.
        processes: How many processes share the work; 1 runs in this one. None: 2, or 1 if
            ``quick``.

    Returns:
        One row per candidate, in the order of the space.
    """
    candidates = space(quick)
    count = processes if processes is not None else (1 if quick else 2)
    done = 0

    def finished(candidate: Candidate) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, len(candidates), f"example {candidate.example}: {candidate.name}")

    if count == 1:
        rows = []
        for candidate in candidates:
            rows.append(judge(candidate))
            finished(candidate)
        return rows
    tasks = [Task(f"{k}", judge, (c,), c.example) for k, c in enumerate(candidates)]
    results = run(tasks, count, lambda task: finished(task.arguments[0]))
    return [results[task.name] for task in tasks]


def judge(candidate: Candidate) -> Row:
    """Simulate one reading and hold it against the criteria.

    Raises:
        InputError: A gain or a plant of the candidate is wrong.
    """
    head = ClosedLoop(candidate.variant("none", False), _OBSERVERS)
    example = head.example
    fault, end = example.fault_s, min(example.duration_s, example.fault_s + HORIZON_S)
    before = integrate(head, candidate.integrator, 0.0, fault, head.initial())
    motion = head.compiled()[1][1]
    ends = [] if before.status == "done" else [f"{before.status} before the fault{_at(before)}"]
    if not ends and not criteria.tracks(_healthy(before, None, motion)):
        ends = ["does not track before the fault"]
    branches: dict[str, Stretch] = {}

    def branch(name: str, gain: str, faulty: bool) -> None:
        loop = ClosedLoop(candidate.variant(gain, faulty), _OBSERVERS)
        loop.enter(True)
        stretch = integrate(loop, candidate.integrator, fault, end, before.end)
        branches[name] = stretch
        if stretch.status != "done":
            ends.append(f"{stretch.status} {name}{_at(stretch)}")

    if not ends:
        branch("without fault", "none", False)
        branch("with fault", "none", True)
        branch("with gain", _OBSERVERS[_TRUE].name, True)
    after = fault + criteria.AFTER_S
    rho = {
        which: min(
            (_rho_error(branches[name], candidate, which, fault + example.settle_s)
             for name in ("with fault", "with gain") if name in branches),
            default=float("nan"),
        )
        for which in (_TRUE, _MEASURED)
    }  # fmt: skip
    if criteria.follows(rho[_MEASURED]):
        branch("with gain on measured signals", _OBSERVERS[_MEASURED].name, True)
    late = {name: _level(part, motion, after) for name, part in branches.items()}
    nothing = float("nan")
    healthy = _healthy(before, branches.get("without fault"), motion)
    bare = late.get("with fault", nothing)
    same = late.get("without fault", nothing)
    gained = late.get("with gain", nothing)
    return Row(
        candidate.example, candidate.group, candidate.name, "; ".join(ends) or "done",
        healthy, same, bare, gained, late.get("with gain on measured signals", nothing),
        rho[_TRUE], rho[_MEASURED], criteria.tracks(healthy), criteria.cannot_follow(bare, same),
        criteria.tracks(gained), criteria.follows(rho[_TRUE]), criteria.follows(rho[_MEASURED]),
    )  # fmt: skip


def _at(stretch: Stretch) -> str:
    return f", at {stretch.t[-1]:.3g} s"


def _error(stretch: Stretch, motion: Any, start_s: float) -> F64:
    """Tracking error of joint 1 from a time on, rad; infinite at the end if it left."""
    desired = np.empty((3, 2))
    error = np.full(len(stretch.t), np.nan)
    for k, t in enumerate(stretch.t):
        if t >= start_s:
            sines(t, *motion, desired)
            error[k] = stretch.q[k, 0] - desired[0, 0]
    error = error[stretch.t >= start_s]
    return np.append(error, np.inf) if stretch.status == "escaped" else error


def _level(stretch: Stretch, motion: Any, start_s: float) -> float:
    """RMS error of joint 1 from a time on, rad; NaN if the solver gave up on the way."""
    if stretch.status == "gave up":
        return float("nan")
    return criteria.rms(_error(stretch, motion, start_s))


def _healthy(before: Stretch, after: Stretch | None, motion: Any) -> float:
    """RMS error of joint 1 without the fault once settled, rad."""
    parts = [before] if after is None else [before, after]
    if any(part.status == "gave up" for part in parts):
        return float("nan")
    return criteria.rms(np.concatenate([_error(p, motion, criteria.SETTLED_S) for p in parts]))


def _rho_error(stretch: Stretch, candidate: Candidate, which: int, start_s: float) -> float:
    """RMS error of ρ̂_1 from a time on; NaN if the stretch did not come to its end."""
    if stretch.status != "done":
        return float("nan")
    late = stretch.t >= start_s
    example = ClosedLoop(candidate.variant("none", True), _OBSERVERS).example
    return criteria.rms(stretch.rho_hat[late, which] - example.effectiveness(stretch.t[late]))


def summary(rows: Sequence[Row]) -> list[str]:
    """What the search found, one sentence each."""
    lines = []
    for example, (one, two, four, five) in ((1, (1, 2, 4, 5)), (2, (6, 7, 9, 10))):
        mine = [row for row in rows if row.example == example]
        lost = [row for row in mine if row.tracks and row.cannot_follow]
        lines += [
            f"Figures {one}, {two} and {five}: {_some([r for r in lost if r.needs_gain], mine)}.",
            f"Figures {one} and {two}, not regained with the gain: "
            f"{_some([r for r in lost if not r.needs_gain], mine)}.",
            f"Figures {one} and {four}, ρ̂ fed with the true ρ: "
            f"{_some([r for r in mine if r.tracks and r.rho_true], mine)}.",
            f"Figures {one} and {four}, ρ̂ on measured signals: "
            f"{_some([r for r in mine if r.tracks and r.rho_measured], mine)}.",
            f"Undecided in example {example}, the solver gave up: "
            f"{sum('gave up' in row.status for row in mine)} of {len(mine)} readings.",
        ]
    every = [
        {row.reading for row in rows if row.example == example and row.needs_gain and row.rho_true}
        for example in (1, 2)
    ]
    both = [row for row in rows if row.example == 1 and row.reading in every[0] & every[1]]
    tried = {row.reading for row in rows if row.example == 1}
    tried &= {row.reading for row in rows if row.example == 2}
    shared = [row for row in rows if row.example == 1 and row.reading in tried]
    if shared:
        lines.append(
            f"Figures 1, 2, 4-7, 9 and 10 at once, ρ̂ fed with the true ρ: {_some(both, shared)}."
        )
    return lines


def _some(good: Sequence[Row], all_of: Sequence[Row]) -> str:
    """How many readings, and which if they are few."""
    if not good:
        return f"none of {len(all_of)} readings"
    names = ": " + "; ".join(row.reading for row in good) if len(good) <= _FEW else ""
    return f"{len(good)} of {len(all_of)} readings{names}"


_HEADINGS: Final = (
    "example", "reading", "healthy/mrad", "fault/mrad", "gain/mrad", "ρ̂ true ρ", "ρ̂ measured",
    "1/6", "2/7", "5/10", "4/9 true ρ", "4/9 measured", "status",
)  # fmt: skip


def table(rows: Iterable[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines = ["| " + " | ".join(_HEADINGS) + " |", "|" + "---|" * len(_HEADINGS)]
    for row in rows:
        cells = (
            str(row.example), row.reading, _milli(row.healthy_rad), _milli(row.bare_rad),
            _milli(row.gained_rad), _number(row.rho_true_rmse), _number(row.rho_measured_rmse),
            *(_mark(row, flag) for flag in
              ("tracks", "cannot_follow", "regains", "rho_true", "rho_measured")),
            row.status,
        )  # fmt: skip
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _milli(rad: float) -> str:
    return _number(1e3 * rad)


def _number(value: float) -> str:
    if math.isnan(value):
        return "–"
    return "left" if math.isinf(value) else f"{value:.3g}"


def _mark(row: Row, flag: str) -> str:
    return "yes" if getattr(row, flag) else "no"


def to_json(rows: Iterable[Row]) -> str:
    """Return the rows as JSON; what is not finite is a string, or null for NaN."""
    plain = [{name: _plain(value) for name, value in asdict(row).items()} for row in rows]
    return json.dumps(plain, ensure_ascii=False, indent=1) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf"
    return value


def columns() -> list[str]:
    """Names of a row's fields, as a CSV file's header."""
    return [field.name for field in fields(Row)]
