"""The results file: written row by row, torn, taken up again, and of another version."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from dftc_rt.benchmark.rows import (
    FAULT_COLUMNS,
    NEGATIVE_COLUMNS,
    SWEEP_COLUMNS,
    FaultRow,
    NegativeRow,
    SweepRow,
)
from dftc_rt.benchmark.store import Store, load_faults, load_negative, set_aside
from dftc_rt.errors import InputError
from tests.unit.benchmark.made_up import case, healthy


def written(path: Path, *rows: FaultRow) -> None:
    store = Store(path, list(FAULT_COLUMNS), [])
    for row in rows:
        store.append(row)
    store.close()


def test_every_column_is_described() -> None:
    assert set(FAULT_COLUMNS) == set(FaultRow.__struct_fields__)
    assert set(NEGATIVE_COLUMNS) == set(NegativeRow.__struct_fields__)
    assert set(SWEEP_COLUMNS) == set(SweepRow.__struct_fields__)


def test_rows_come_back_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    rows = [
        case(1, reason='x: "lost", 3 rad', end_state="safe stop", rmse_mrad=0.123456),
        case(2, anomaly_delay_s=None, beyond=True),
    ]
    written(path, *rows)
    assert load_faults(path) == rows
    store = Store(tmp_path / "negative.csv", list(NEGATIVE_COLUMNS), [healthy(1)])
    store.append(healthy(2, joints="a b"))
    store.close()
    assert load_negative(tmp_path / "negative.csv") == [healthy(1), healthy(2, joints="a b")]


def test_none_is_an_empty_cell_and_a_flag_a_word(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    written(path, case(1, anomaly_delay_s=None, beyond=True))
    with path.open(newline="") as stream:
        (cells,) = csv.DictReader(stream)
    assert cells["anomaly_delay_s"] == ""
    assert cells["beyond"] == "true"
    assert cells["rho_rmse"] == "0.02"


def test_a_row_is_there_at_once(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    store = Store(path, list(FAULT_COLUMNS), [])
    store.append(case(1))
    assert load_faults(path) == [case(1)]
    store.close()


def test_a_torn_line_is_left_out_and_gone_afterwards(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    written(path, case(1), case(2))
    path.write_text(path.read_text()[:-20])
    found = load_faults(path)
    assert found == [case(1)]
    store = Store(path, list(FAULT_COLUMNS), found)
    store.append(case(3))
    store.close()
    assert load_faults(path) == [case(1), case(3)]


def test_no_file_has_no_rows(tmp_path: Path) -> None:
    assert load_faults(tmp_path / "none.csv") == []


def test_another_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    path.write_text("name,phone\nx,1\n")
    with pytest.raises(InputError, match=r"results\.csv: other columns"):
        load_faults(path)
    assert path.exists()


def test_the_file_of_another_version_is_moved_aside(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    for number in (1, 2):
        path.write_text("id,fingerprint,robot\nx,y,z\n")
        assert load_faults(path) == []
        assert not path.exists()
        assert len(list(tmp_path.glob("results.old*.csv"))) == number


def test_a_value_that_is_none_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    written(path, case(1), case(2))
    path.write_text(path.read_text().replace(",0.02,", ",x,"))
    with pytest.raises(InputError, match=r"results\.csv:2: .*float"):
        load_faults(path)


def test_rows_of_other_sources_go_to_files_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    for number in (1, 2):
        rows = [case(number, fingerprint="a"), case(number, fingerprint="b")]
        files = set_aside(path, list(FAULT_COLUMNS), rows)
        assert [file.name for file in files] == ["results.a.csv", "results.b.csv"]
    assert [row.seed for row in load_faults(tmp_path / "results.a.csv")] == [1, 2]
