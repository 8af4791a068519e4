"""The page: how to read it, and all tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from dftc_rt.benchmark import figures, information, tables_cases, tables_laws
from dftc_rt.benchmark.aims import Aim, aims
from dftc_rt.benchmark.conditions import (
    BEYOND_SHARE,
    END_S,
    FAULT_S,
    LOADED,
    NEGATIVE_S,
    RIG,
    SEEDS,
    seeds_of,
)
from dftc_rt.benchmark.frozen import Frozen
from dftc_rt.benchmark.rows import COMMON, FAULT_COLUMNS, NEGATIVE_COLUMNS, FaultRow
from dftc_rt.benchmark.select import Rows
from dftc_rt.benchmark.table import Table

_FIGURES: Final = {
    figures.DELAYS: "Shares of cases noticed and attributed, over the time since the fault",
    figures.ESTIMATES: "Error of ρ̂ over the load of the joint",
    figures.TRACKING: "Error of the faulted joint over its twin's",
}


@dataclass(frozen=True)
class Facts:
    """What the page says besides its rows.

    Attributes:
        momentum_threshold: Factor on the calibrated threshold of the law ``momentum``.
        marks: Robot -> fingerprint of sources and calibration.
        frozen: Settings that were frozen before the sealed draw; None: not yet.
        settings: Further overrides of every run's scenario.
    """

    momentum_threshold: float
    marks: Mapping[str, str]
    frozen: Frozen | None
    settings: Sequence[str] = ()


def markdown(rows: Rows, facts: Facts, drawn: Sequence[str]) -> str:
    """The page.

    Args:
        rows: All rows of a draw.
        facts: What else it says.
        drawn: Names of the figures that there are.
    """
    tables = [
        tables_cases.aims_table(aims(rows)), tables_laws.delays(rows),
        tables_laws.estimates(rows), tables_laws.tracking(rows), tables_laws.effort(rows),
        tables_laws.alarms(rows), tables_cases.items(rows), tables_laws.total(rows),
        tables_laws.interconnections(rows), tables_cases.robots(rows),
        tables_cases.marked(rows), tables_cases.unloaded(rows), tables_cases.missed(rows),
        _columns("Columns of both files", COMMON, {}),
        _columns("Further columns of results.csv", FAULT_COLUMNS, COMMON),
        _columns("Further columns of negative.csv", NEGATIVE_COLUMNS, COMMON),
    ]  # fmt: skip
    images = [f"![{_FIGURES[name]}]({name})\n\n*{_FIGURES[name]}.*" for name in drawn]
    first, rest = tables[0], tables[1:]
    parts = [_head(rows, facts), first.markdown(), *images, *(each.markdown() for each in rest)]
    return "\n\n".join(parts) + "\n"


def as_json(rows: Rows, facts: Facts) -> dict[str, Any]:
    """The aims and the extent, ready for JSON."""

    def plain(aim: Aim) -> dict[str, Any]:
        return {"aim": aim.title, "reached": aim.reached, "met": aim.met, "cases": aim.n}

    return {
        "draw": rows.draw,
        "aims": [plain(aim) for aim in aims(rows)],
        "cases": len(_cases(rows.faults)),
        "negative_runs": len(rows.negative),
        "simulated_s": _simulated_s(rows),
        "cpu_s": _cpu_s(rows),
        "momentum_threshold": facts.momentum_threshold,
        "fingerprints": dict(facts.marks),
        "frozen": None if facts.frozen is None else facts.frozen.settings,
    }


def _columns(title: str, columns: Mapping[str, str], but: Mapping[str, str]) -> Table:
    lines = [(f"`{name}`", text) for name, text in columns.items() if name not in but]
    return Table(title, ("column", "meaning"), lines)


def _cases(rows: Sequence[FaultRow]) -> list[FaultRow]:
    return [row for row in rows if row.kind != "twin"]


def _twins(rows: Sequence[FaultRow]) -> dict[str, FaultRow]:
    """One row of each twin, of which every joint has a row."""
    return {row.id.rsplit("/", 1)[0]: row for row in rows if row.kind == "twin"}


def _simulated_s(rows: Rows) -> float:
    every = (*_cases(rows.faults), *_twins(rows.faults).values(), *rows.negative)
    return sum(row.simulated_s for row in every)


def _cpu_s(rows: Rows) -> float:
    every = (*_cases(rows.faults), *_twins(rows.faults).values(), *rows.negative)
    return sum(row.cpu_s for row in every)


def _head(rows: Rows, facts: Facts) -> str:
    seeds = "; ".join(
        f"{part} {draw} {first} to {last}"
        for part in ("faults", "negative")
        for draw in ("tuning", "sealed")
        for first, last in [seeds_of(part, draw)]
    )
    failed = [row for row in _twins(rows.faults).values() if row.end_state != "done"]
    stopped = (
        f" {len(failed)} twins ended in a safe stop and have no cases: "
        + ", ".join(sorted({f"{row.robot} {row.variant} ({row.reason})" for row in failed}))
        + "."
        if failed
        else ""
    )
    marks = ", ".join(f"{robot} `{mark}`" for robot, mark in sorted(facts.marks.items())) or "–"
    frozen = (
        "Nothing was frozen: these numbers are of the draw that settings were chosen with."
        if facts.frozen is None
        else f"Frozen {facts.frozen.when}, settings `{facts.frozen.settings}`, before any sealed "
        "run; the sealed draw was run with these."
    )
    changed = "".join(f" With `{each}`." for each in facts.settings)
    cases, twins = len(_cases(rows.faults)), len(_twins(rows.faults))
    lines = [
        "# Benchmark of faults",
        "",
        "    dftc benchmark faults -o benchmark --freeze            # the draw to tune with",
        "    dftc benchmark faults -o benchmark --draw sealed --hours 10",
        "",
        "This page is what that command wrote; every number is made from "
        "`results.csv` and `negative.csv`, which have a row a run. The command can be interrupted, "
        "and goes on where it was. How the estimator works: `docs/estimation.md`.",
        "",
        f"Draw *{rows.draw}*: {cases} cases with {twins} twins, {len(rows.negative)} runs without "
        f"a fault; {_simulated_s(rows) / 3600:.2f} simulated hours in {_cpu_s(rows) / 3600:.2f} "
        f"hours of processor time.{stopped} {frozen} Threshold of B1: "
        f"{facts.momentum_threshold:g} times the calibrated.{changed} Sources and calibrations: "
        f"{marks}.",
        "",
        f"- **Case**: a run of {END_S:g} s at 1 kHz; the fault begins at {FAULT_S:g} s. Its *twin* "
        "is the same run without it. One calibration for each robot, made on other motion; every "
        "law gets it.",
        f"- **Rig**, unknown to the controller: {', '.join(f'`{item}`' for item in RIG)}.",
        f"- **Loaded**: RMS torque of the twin over {100 * LOADED:g} % of the joint's limit in the "
        "faulty window. Joints below have no faults put on them.",
        "- **Beyond authority**: the twin's torque over ρ(t) exceeds the limit for more than "
        f"{100 * BEYOND_SHARE:g} % of the time of the fault; marked, not averaged in.",
        "- **Evidence** for a loss: ½ ∫ e²/R, e the torque that is missing, (1 - ρ) times that "
        "asked for, through the estimator's filter, R the square of the calibrated residual floor "
        "times the inflation, a sample every millisecond. For an anomaly it is there at "
        f"{information.ANOMALY_EVIDENCE:g}, for an attribution at "
        f"{information.ATTRIBUTION_EVIDENCE:g} times the joint's `threshold_anomaly`. A loss is "
        "*distinct* when the same without the part that the best constant torque explains is "
        f"there {information.DISTINCT_EVIDENCE:g} times: until the torque asked for has changed, "
        "nobody can tell.",
        f"- **Negative set**: runs of {NEGATIVE_S:g} s without a fault of an actuator.",
        f"- **Seeds** of motion and noise ({SEEDS} each): {seeds}; calibration from 1001 on.",
    ]
    return "\n".join(lines)
