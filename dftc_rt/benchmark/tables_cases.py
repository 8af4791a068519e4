"""Tables of the law ``dftc``: what was to be reached, by joint, by item, and single cases."""

from __future__ import annotations

from collections.abc import Sequence

from dftc_rt.benchmark import statistics
from dftc_rt.benchmark.aims import Aim, informed, late
from dftc_rt.benchmark.negative import ITEMS
from dftc_rt.benchmark.rows import NegativeRow
from dftc_rt.benchmark.select import Rows
from dftc_rt.benchmark.table import Cells, Table, number


def aims_table(found: Sequence[Aim]) -> Table:
    """What was to be reached."""
    words = {True: "yes", False: "**no**", None: "open"}
    rows = [(aim.title, aim.reached, words[aim.met], aim.n) for aim in found]
    return Table(
        "What was to be reached", ("aim", "reached", "met", "cases"), rows,
        "Of single cases: constant loss of 40 % on a loaded joint, law `dftc`, `desired`, within "
        "the joint's torque authority. *Open*: there are no such rows, or fewer than ten hours "
        "without an alarm.",
    )  # fmt: skip


def robots(rows: Rows) -> Table:
    """A loss of 40 % by robot and joint, law ``dftc``."""
    lines = []
    found = rows.cases(kind="loss40")
    for robot, joint in sorted({(row.robot, row.joint) for row in found}):
        own = [row for row in found if (row.robot, row.joint) == (robot, joint)]
        anomaly = statistics.delays([row.anomaly_delay_s for row in own])
        loss = statistics.delays([row.attribution_delay_s for row in own])
        lines.append(
            (robot, joint, f"{len(own)}",
             number(100 * statistics.median([row.torque_share for row in own]), 0),
             number(anomaly.median, 3), number(anomaly.most, 3),
             number(loss.median, 2), number(loss.most, 2),
             number(statistics.pooled([row.rho_rmse for row in own]), 3),
             number(statistics.median([row.rmse_mrad for row in own]), 2),
             number(statistics.median([row.rmse_twin_mrad for row in own]), 2))
        )  # fmt: skip
    header = (
        "robot", "joint", "cases", "load, %", "anomaly, median", "95 %", "loss, median", "95 %",
        "RMSE of ρ̂", "RMSE, mrad", "twin's",
    )  # fmt: skip
    note = "Loss of 40 %, law `dftc`, `desired`. Load: RMS torque of the twin, of the limit."
    return Table("By robot and joint", header, lines, note)


def items(rows: Rows) -> Table:
    """The negative set by item, law ``dftc``."""
    lines = []
    for item in ITEMS:
        found = [row for row in rows.healthy() if row.item == item.name]
        if found:
            hours = sum(row.simulated_s for row in found) / 3600.0
            lines.append((item.name, f"{len(found)}", *_item(found, hours)))
    header = ("motion", "runs", "false alarms", "s", "wrong gain, s", "anomalies per hour",
              "worst RMSE, mrad", "where")  # fmt: skip
    return Table("The negative set, item by item", header, lines, "Law `dftc`, `desired`.")


def _item(found: Sequence[NegativeRow], hours: float) -> Cells:
    where = sorted({f"{row.robot} {name}" for row in found for name in row.joints.split()})
    return (
        f"{sum(row.false_alarms for row in found)}",
        number(sum(row.false_alarm_s for row in found), 2),
        number(sum(row.wrong_gain_s for row in found), 2),
        number(sum(row.anomalies for row in found) / hours, 0),
        number(statistics.largest([row.worst_mrad for row in found]), 1),
        ", ".join(where) or "–",
    )


def marked(rows: Rows) -> Table:
    """Cases beyond the joint's authority, of the law ``dftc``; counted, not averaged in."""
    found = [row for row in rows.of_law() if row.beyond]
    lines = [
        (robot, joint, kind,
         f"{sum((r.robot, r.joint, r.kind) == (robot, joint, kind) for r in found)}")
        for robot, joint, kind in sorted({(row.robot, row.joint, row.kind) for row in found})
    ]  # fmt: skip
    return Table("Cases beyond the torque authority", ("robot", "joint", "fault", "cases"), lines,
                 "The twin's torque over ρ(t) exceeds the limit for more than 1 % of the fault's "
                 "time. These are in no other table.")  # fmt: skip


def unloaded(rows: Rows) -> Table:
    """Joints without load: no faults are put on them."""
    twins = [row for row in rows.of_law() if row.kind == "twin"]
    lines = []
    for robot, joint in sorted({(row.robot, row.joint) for row in twins if not row.loaded}):
        own = [row for row in twins if (row.robot, row.joint) == (robot, joint)]
        free = [row for row in own if not row.loaded]
        share = 100 * statistics.median([row.torque_share for row in free])
        lines.append((robot, joint, f"{len(free)} of {len(own)}", f"{share:.1f}"))
    return Table("Joints that carry no load", ("robot", "joint", "seeds", "torque, % of limit"),
                 lines, "RMS of the twin's torque at most 5 % of the limit.")  # fmt: skip


def missed(rows: Rows) -> Table:
    """Every case in which the evidence was there after 150 ms, and the anomaly was not."""
    lines = [
        (row.robot, row.joint, f"{row.seed}", row.kind, number(row.evidence_150ms, 1),
         number(row.anomaly_information_s, 3), number(row.anomaly_delay_s, 3))
        for row in sorted(rows.cases(), key=lambda row: row.id)
        if late(row) and row.kind != "total"
    ]  # fmt: skip
    every = sum(informed(row) for row in rows.cases() if row.kind != "total")
    return Table("Anomalies that came late", ("robot", "joint", "seed", "fault",
                 "evidence at 150 ms", "evidence there, s", "anomaly, s"), lines,
                 f"Of {every} cases of the law `dftc` whose evidence was there within 150 ms, of "
                 "all kinds but the total loss.")  # fmt: skip
