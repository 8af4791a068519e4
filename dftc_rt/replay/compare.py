"""Where a replay differs from its log, to the last bit."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dftc_rt.log.ending import ending_of
from dftc_rt.log.run import Run
from dftc_rt.replay.loop import Replayed
from dftc_rt.rt.supervisor import State

F64 = NDArray[np.float64]

SIGNALS: Final = (
    "t", "overruns", "skipped", "state", "q", "v", "age", "status", "qd", "vd", "ad",
    "observable", "rho_hat", "rho_std", "residual", "verdict", "s", "tau_law", "tau_cmd",
)  # fmt: skip
"""What is compared, causes first: of several differences in a cycle the first is told."""


@dataclass(frozen=True)
class Difference:
    """One value that differs.

    Attributes:
        cycle: Number of the cycle.
        t: Its time, s.
        joint: Name; "" for a field of the whole cycle.
        signal: Field of ``/cycle``, or ``end``: how the run ended.
        logged: Value in the log, or what it says about the end.
        replayed: Value of the replay, or its end.
    """

    cycle: int
    t: float
    joint: str
    signal: str
    logged: float | str
    replayed: float | str


@dataclass(frozen=True)
class Spread:
    """How much one signal differs over the whole replay.

    Attributes:
        signal: Field of ``/cycle``.
        cycles: Cycles in which any joint differs.
        largest: Largest absolute difference, in the signal's unit; NaN where one is no number.
        joint: Where that is; "" for a field of the whole cycle.
        t: When, s.
    """

    signal: str
    cycles: int
    largest: float
    joint: str
    t: float


@dataclass(frozen=True)
class Comparison:
    """A replay against its log.

    Attributes:
        cycles: Cycles that were replayed.
        logged: Cycles in the log.
        first: The first difference; None: equal to the last bit.
        spreads: Of the signals that differ, causes first.
    """

    cycles: int
    logged: int
    first: Difference | None
    spreads: tuple[Spread, ...]

    def builtins(self) -> dict[str, Any]:
        """The same for JSON; a largest difference that is no number is None."""
        found = asdict(self)
        for each in found["spreads"]:
            each["largest"] = each["largest"] if np.isfinite(each["largest"]) else None
        return found


def compare(run: Run, replayed: Replayed) -> Comparison:
    """Compare a replay with its log; NaN equals NaN, and 0 is not -0.

    Args:
        run: The log.
        replayed: From :func:`dftc_rt.replay.loop.replay`.
    """
    count = len(replayed.cycle["t"])
    first: tuple[int, str, int] | None = None
    spreads = []
    for name in SIGNALS:
        ours = replayed.cycle[name].reshape(count, -1)
        theirs = np.ascontiguousarray(run.cycle[name][:count]).reshape(count, -1)
        other = _differs(np.ascontiguousarray(ours), theirs)
        rows = np.flatnonzero(other.any(axis=1))
        if not rows.size:
            continue
        at = int(rows[0])
        if first is None or at < first[0]:
            first = at, name, int(np.flatnonzero(other[at])[0])
        spreads.append(_spread(run, name, rows.size, np.where(other, np.abs(ours - theirs), 0.0)))
    if first is None:
        told = _end(run, replayed)
    else:
        at, name, i = first
        told = Difference(
            *_when(run, at),
            run.joints[i] if run.cycle[name].ndim > 1 else "",
            name,
            _value(name, run.cycle[name], at, i),
            _value(name, replayed.cycle[name], at, i),
        )
    return Comparison(count, len(run.cycle["t"]), told, tuple(spreads))


def _differs(a: F64, b: F64) -> NDArray[np.bool_]:
    same: NDArray[np.bool_] = (a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))
    return ~same


def _value(name: str, rows: F64, at: int, i: int) -> float | str:
    value = float(rows[at] if rows.ndim == 1 else rows[at, i])
    if name == "state":
        return State(int(value)).name.lower().replace("_", " ")
    return value if np.isfinite(value) else str(value)


def _when(run: Run, at: int) -> tuple[int, float]:
    t = run.cycle["t"]
    period = float(np.min(np.diff(t))) if len(t) > 1 else 1.0
    return round(float(t[at]) / period), float(t[at])


def _spread(run: Run, name: str, cycles: int, size: F64) -> Spread:
    missing = np.isnan(size)  # one of the two is no number
    flat = int(np.argmax(np.where(missing, np.inf, size)))
    at, i = divmod(flat, size.shape[1])
    joint = run.joints[i] if run.cycle[name].ndim > 1 else ""
    return Spread(name, cycles, float(size[at, i]), joint, float(run.cycle["t"][at]))


def _end(run: Run, replayed: Replayed) -> Difference | None:
    """Whether a run that is equal to its last record has ended otherwise than the log says.

    A log that is cut off says nothing, and no replay ends as a run whose last bus was lost.
    """
    ending = ending_of(run.events)
    last = len(replayed.cycle["t"]) - 1
    if replayed.ended and last + 1 < len(run.cycle["t"]):
        return Difference(*_when(run, last + 1), "", "end", "goes on", _told(replayed))
    if ending is None or ending.cycles != last + 1:
        return None
    if not replayed.ended and ending.reason.startswith("bus lost"):
        return None
    logged = f"{ending.end_state} {ending.reason}".strip()
    if replayed.ended and _told(replayed).startswith(logged):
        return None
    ours = _told(replayed) if replayed.ended else "goes on"
    return Difference(*_when(run, last), "", "end", logged, ours)


def _told(replayed: Replayed) -> str:
    return f"{replayed.outcome.end_state} {replayed.outcome.reason}".strip()
