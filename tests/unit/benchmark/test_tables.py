"""Tables and page from made-up rows."""

from __future__ import annotations

import re
from pathlib import Path

from dftc_rt.benchmark import figures, page, tables_cases, tables_laws
from dftc_rt.benchmark.select import Rows
from dftc_rt.benchmark.table import Table, number
from tests.unit.benchmark.made_up import case, healthy


def rows(*faults: object, negative: object = ()) -> Rows:
    return Rows.of("tuning", 1.0, faults, negative)  # type: ignore[arg-type]


def test_a_table_is_markdown() -> None:
    table = Table("Title", ("a", "b"), [("1", "x|y")], "Note.")
    assert table.markdown() == "## Title\n\n| a | b |\n| --- | --- |\n| 1 | x\\|y |\n\nNote."
    assert Table("Title", ("a",), []).markdown() == "## Title\n\nNone."


def test_numbers_that_are_none() -> None:
    assert number(1.2345, 2) == "1.23"
    assert number(None, 2) == number(float("nan"), 2) == "–"
    assert number(float("inf"), 2) == "never"


def test_delays_by_law_and_kind() -> None:
    found = tables_laws.delays(
        rows(
            case(1), case(2, anomaly_delay_s=0.07), case(3, anomaly_delay_s=None),
            case(1, kind="ramp"), case(1, variant="momentum", attribution_delay_s=0.2),
            case(4, beyond=True), case(5, kind="total"), case(6, kind="twin"),
        )
    )  # fmt: skip
    assert found.rows == [
        ("dftc", "loss40", "3", "0.070", "never", "0.070", "1", "0.400", "0.400", "0.400", "0"),
        ("dftc", "ramp", "1", "0.050", "0.050", "0.050", "0", "0.400", "0.400", "0.400", "0"),
        ("B1 momentum observer", "loss40", "1", "0.050", "0.050", "0.050", "0",
         "0.200", "0.200", "0.200", "0"),
    ]  # fmt: skip


def test_the_estimate_weighs_its_samples() -> None:
    found = tables_laws.estimates(
        rows(
            case(1, rho_rmse=0.03, within_2_std=1.0, std_samples=3000),
            case(2, rho_rmse=0.04, within_2_std=0.6, std_samples=1000, rho_settle_s=None),
            case(1, kind="sine", rho_settle_s=None),
        )
    )
    assert found.rows[0] == (
        "dftc", "loss40", "2", "0.035", "0.035", "0.040", "0.50", "1", "90.0 %", "1.50",
    )  # fmt: skip
    assert found.rows[1][6:8] == ("–", "–")  # a sine never settles


def test_tracking_has_the_others_as_well() -> None:
    found = tables_laws.tracking(
        rows(
            case(1, rmse_mrad=0.5, other_mrad=0.3, other_twin_mrad=0.1),
            case(2, rmse_mrad=2.0, end_state="safe stop", other_mrad=None, other_twin_mrad=None),
        )
    )
    assert found.rows == [
        ("dftc", "loss40", "2", "1.25", "1.92", "0.40", "50 %", "5.0", "3.00", "0.20", "1")
    ]


def test_alarms_have_an_interval() -> None:
    found = tables_laws.alarms(
        rows(negative=[healthy(1, false_alarms=1, false_alarm_s=2.5), healthy(2, anomalies=30)])
    )
    assert found.rows == [("dftc", "2.00", "1", "0.5 (0.013 to 2.8)", "2.50", "0.00", "15.0", "0")]


def test_items_say_where() -> None:
    found = tables_cases.items(
        rows(negative=[healthy(1, item="hold"), healthy(2, joints="elbow lift", false_alarms=2)])
    )
    assert [row[0] for row in found.rows] == ["multisine", "hold"]
    assert found.rows[0][-1] == "ur5 elbow, ur5 lift"
    assert found.rows[1][-1] == "–"


def test_total_loss_names_its_joint() -> None:
    found = tables_laws.total(
        rows(
            case(1, kind="total", need_s=0.0, stop_s=0.3, reason="elbow: tracking error"),
            case(2, kind="total", need_s=0.1, stop_s=0.2, reason="lift: tracking error"),
        )
    )
    assert found.rows == [("dftc", "2", "0.100", "0.300", "0.300", "0", "5", "1")]


def test_interconnections_on_the_cases_that_all_have() -> None:
    found = tables_laws.interconnections(
        rows(case(1), case(2), case(1, interconnection="frozen", rho_rmse=0.5))
    )
    assert [(row[0], row[1], row[6]) for row in found.rows] == [
        ("`desired`", "1", "0.020"), ("`frozen`", "1", "0.500"),
    ]  # fmt: skip


def test_marked_and_unloaded_are_counted() -> None:
    found = rows(
        case(1, beyond=True), case(2, beyond=True), case(3),
        case(1, kind="twin", joint="wrist", loaded=False, torque_share=0.01),
        case(2, kind="twin", joint="wrist", loaded=True, torque_share=0.06),
    )  # fmt: skip
    assert tables_cases.marked(found).rows == [("ur5", "elbow", "loss40", "2")]
    assert tables_cases.unloaded(found).rows == [("ur5", "wrist", "1 of 2", "1.0")]


def test_every_late_anomaly_is_listed() -> None:
    found = tables_cases.missed(rows(case(1), case(2, anomaly_delay_s=None), case(3, kind="ramp")))
    assert found.rows == [("ur5", "elbow", "2", "loss40", "90.0", "0.010", "–")]
    assert "Of 3 cases" in found.note


def test_of_a_case_that_was_run_twice_the_last_counts() -> None:
    found = rows(case(1, rho_rmse=0.5), case(1, rho_rmse=0.1))
    assert [row.rho_rmse for row in found.cases()] == [0.1]


def test_the_other_draw_is_not_in_it() -> None:
    found = Rows.of("sealed", 1.0, [case(1), case(2, draw="sealed")], [healthy(1)])
    assert [row.seed for row in found.cases()] == [2]
    assert found.healthy() == []


def test_the_page_has_every_table_and_figure(tmp_path: Path) -> None:
    every = rows(
        case(1), case(1, kind="twin"), case(1, variant="momentum"), negative=[healthy(1)],
    )  # fmt: skip
    drawn = figures.draw_all(every, tmp_path)
    text = page.markdown(every, page.Facts(2.0, {"ur5": "abc"}, None), drawn)
    for name in re.findall(r"!\[.*?\]\((.*?)\)", text):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    assert len(drawn) == 3
    assert "2 cases with 1 twins, 1 runs without" in text
    assert "B1: 2 times the calibrated" in text
    for title in ("Delays", "Effectiveness", "Tracking", "Total loss", "Anomalies that came late"):
        assert f"## {title}\n" in text
    assert "| `rho_rmse` | RMS of ρ̂ - ρ" in text
    assert "nan" not in text
    assert "inf " not in text


def test_a_page_without_rows(tmp_path: Path) -> None:
    empty = rows()
    assert figures.draw_all(empty, tmp_path) == []
    text = page.markdown(empty, page.Facts(1.0, {}, None), [])
    assert "0 cases" in text
    assert "nan" not in text


def test_json_has_the_aims_and_the_extent() -> None:
    every = rows(case(1), case(1, kind="twin"), case(1, kind="twin", joint="lift"))
    found = page.as_json(every, page.Facts(1.0, {"ur5": "abc"}, None))
    assert found["cases"] == 1
    assert found["simulated_s"] == 16.0  # a case and its twin, whatever the joints
    assert {"aim", "reached", "met", "cases"} == set(found["aims"][0])
