"""Tables that compare laws, from rows of the results."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dftc_rt.benchmark import statistics
from dftc_rt.benchmark.aims import figures, stop_after_need, tracked
from dftc_rt.benchmark.cases import KINDS
from dftc_rt.benchmark.rows import FaultRow
from dftc_rt.benchmark.select import Rows
from dftc_rt.benchmark.table import Cells, Table, delay_cells, law_title, number


def by_law(
    rows: Rows,
    title: str,
    header: Cells,
    columns: Callable[[list[FaultRow]], Cells],
    note: str = "",
    kinds: Sequence[str] = tuple(KINDS),
) -> Table:
    """A row for each law and kind of fault that has cases."""
    lines = []
    for variant, where in rows.laws():
        for kind in kinds:
            found = rows.cases(variant, where, kind)
            if found:
                lines.append((law_title(variant, where), kind, f"{len(found)}", *columns(found)))
    return Table(title, ("law", "fault", "cases", *header), lines, note)


def delays(rows: Rows) -> Table:
    """Delays by law and kind."""

    def columns(found: list[FaultRow]) -> Cells:
        anomaly = statistics.delays([row.anomaly_delay_s for row in found])
        loss = statistics.delays([row.attribution_delay_s for row in found])
        return (*delay_cells(anomaly), *delay_cells(loss))

    return by_law(
        rows, "Delays",
        ("anomaly: median", "95 %", "max", "never", "loss: median", "95 %", "max", "never"),
        columns,
        "From the fault, s; a ramp begins when ρ falls below 0.95. Percentiles count a case that "
        "was never noticed as longer than all others; *max* is of those that were.",
        [kind for kind in KINDS if kind != "total"],
    )  # fmt: skip


def estimates(rows: Rows) -> Table:
    """Error of ρ̂ and its standard deviation, by law and kind."""

    def columns(found: list[FaultRow]) -> Cells:
        errors = [row.rho_rmse for row in found]
        settled = statistics.delays([row.rho_settle_s for row in found])
        samples = [row for row in found if row.std_samples and row.within_2_std is not None]
        count = sum(row.std_samples for row in samples)
        inside = sum((row.within_2_std or 0.0) * row.std_samples for row in samples)
        width = statistics.median([row.std_over_rmse for row in samples])
        restless = found[0].kind in ("sine", "intermittent")
        return (
            number(statistics.pooled(errors), 3),
            number(statistics.median(errors), 3),
            number(statistics.quantile(errors, 0.95), 3),
            *(("–", "–") if restless else (number(settled.median, 2), f"{settled.never}")),
            f"{100 * inside / count:.1f} %" if count else "–",
            number(width, 2),
        )

    return by_law(
        rows, "Effectiveness",
        ("RMSE, all samples", "median", "95 %", "settled, median", "never", "within 2σ", "σ/RMSE"),
        columns,
        "RMSE of ρ̂ from 0.5 s after the fault on; settled: last time that it is off by more than "
        "0.05, s. The last two from 0.5 s after the attribution, while observable.",
        [kind for kind in KINDS if kind != "total"],
    )  # fmt: skip


def tracking(rows: Rows) -> Table:
    """Tracking error beside the twin's, by law and kind."""

    def columns(found: list[FaultRow]) -> Cells:
        others = [
            row.other_mrad / row.other_twin_mrad
            for row in found
            if row.other_mrad is not None and row.other_twin_mrad
        ]
        excess = [
            row.other_mrad - row.other_twin_mrad
            for row in found
            if row.other_mrad is not None and row.other_twin_mrad is not None
        ]
        return (
            number(statistics.median([row.rmse_mrad for row in found]), 2),
            number(statistics.quantile([row.rmse_mrad for row in found], 0.95), 2),
            number(statistics.median([row.rmse_twin_mrad for row in found]), 2),
            f"{100 * sum(map(tracked, found)) / len(found):.0f} %",
            number(statistics.largest([row.peak_mrad for row in found]), 1),
            number(statistics.quantile(others, 0.95), 2),
            number(statistics.largest(excess), 2),
            f"{sum(row.end_state != 'done' for row in found)}",
        )

    return by_law(
        rows, "Tracking",
        ("RMSE, median", "95 %", "twin's", "as the twin", "peak", "others: ratio, 95 %",
         "others: most above", "stopped"),
        columns,
        "Of the faulted joint in the faulty window, mrad. *As the twin*: at most 1.25 of its "
        "error, or 0.5 mrad above. *Others*: the healthy joint whose error grew by most, over its "
        "twin's, and above it in mrad. *Stopped*: runs that ended in a safe stop; their errors "
        "are of the time before.",
        [kind for kind in KINDS if kind != "total"],
    )  # fmt: skip


def effort(rows: Rows) -> Table:
    """Torque by law and kind."""

    def columns(found: list[FaultRow]) -> Cells:
        return (
            number(statistics.median([row.effort for row in found]), 3),
            number(statistics.largest([row.effort for row in found]), 2),
            number(statistics.median([row.effort_all for row in found]), 3),
            f"{sum(row.false_alarms for row in found)}",
            number(sum(row.false_alarm_s for row in found), 2),
            number(sum(row.wrong_gain_s for row in found), 2),
        )

    return by_law(
        rows, "Torque, and alarms beside the fault",
        ("joint: median", "max", "robot: median", "false alarms", "s", "wrong gain, s"),
        columns,
        "RMS command over the twin's: of the faulted joint, and of all in units of their limits. "
        "False alarms: on other joints, before the fault or after it.",
        [kind for kind in KINDS if kind != "total"],
    )  # fmt: skip


def alarms(rows: Rows) -> Table:
    """False alarms of the negative set, by law."""
    lines = []
    for variant, where in rows.laws():
        found = rows.healthy(variant, where)
        if not found:
            continue
        hours = sum(row.simulated_s for row in found) / 3600.0
        count = sum(row.false_alarms for row in found)
        low, high = statistics.poisson_interval(count, hours)
        lines.append(
            (law_title(variant, where), f"{hours:.2f}", f"{count}",
             f"{count / hours:.3g} ({low:.2g} to {high:.2g})",
             number(sum(row.false_alarm_s for row in found), 2),
             number(sum(row.wrong_gain_s for row in found), 2),
             number(sum(row.anomalies for row in found) / hours, 1),
             f"{sum(row.end_state != 'done' for row in found)}")
        )  # fmt: skip
    header = (
        "law", "hours", "false `actuator loss`", "per hour (95 %)", "s", "wrong gain, s",
        "anomalies per hour", "safe stops",
    )  # fmt: skip
    return Table("False alarms without a fault", header, lines,
                 "Interval: Garwood's, of a Poisson rate. Wrong gain: time with ρ̂ < 0.9 acting; "
                 "the gains of B1 and B3 always act.")  # fmt: skip


def total(rows: Rows) -> Table:
    """Total loss, by law."""
    lines = []
    for variant, where in rows.laws():
        found = [row for row in rows.cases(variant, where, "total") if row.need_s is not None]
        if not found:
            continue
        stops = statistics.delays([stop_after_need(row) for row in found])
        peak = statistics.largest([row.peak_mrad for row in found])
        named = sum(row.reason.startswith(f"{row.joint}:") for row in found)
        lines.append((law_title(variant, where), f"{stops.n}", *delay_cells(stops), number(peak, 0),
                      f"{named}"))  # fmt: skip
    header = ("law", "cases", "stop: median", "95 %", "max", "never", "peak, mrad", "joint named")
    return Table("Total loss", header, lines,
                 "Time from the joint needing torque to the safe stop, s. *Joint named*: stops "
                 "whose reason is the joint that was lost.")  # fmt: skip


def interconnections(rows: Rows) -> Table:
    """What the surrogate for the other joints costs, on the cases that all three have."""
    ids = [
        {(row.robot, row.seed, row.joint) for row in rows.cases("dftc", where, "loss40")}
        for where in ("desired", "measured", "frozen")
    ]
    lines = []
    for where, own in zip(("desired", "measured", "frozen"), ids, strict=True):
        shared = set.intersection(*[each for each in ids if each]) if own else set()
        cases = [
            row
            for row in rows.cases("dftc", where, "loss40")
            if (row.robot, row.seed, row.joint) in shared
        ]
        if cases:
            found = figures(cases)
            alarms = sum(row.false_alarms for row in cases)
            lines.append(
                (f"`{where}`", f"{len(cases)}", *(number(v, 3) for v in found.values()),
                 f"{alarms}")
            )  # fmt: skip
    header = ("interconnection", "cases", *figures([]), "false alarms")
    return Table("What the other joints' state is worth", header, lines,
                 "Law `dftc`, loss of 40 %, the same cases for all.")  # fmt: skip
