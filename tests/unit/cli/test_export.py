"""``dftc export``: files of other programs, and one line for what cannot be."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import can
import numpy as np
import pyarrow.parquet as pq
import pytest

from dftc_rt.analysis import load, viewer_layouts
from dftc_rt.bus.frame_record import record_dtype
from dftc_rt.cli.main import run
from dftc_rt.control.signals import NAMES
from dftc_rt.log.recorder import Recorder
from dftc_rt.log.schema import CanLayout, cycle_layout, rig_layout


def write(path: Path, *, rig: bool = True, frames: int = 5) -> Path:
    cycle, truth, layout = (
        cycle_layout(["a.1"], NAMES),
        rig_layout(["a.1"]),
        CanLayout(("can0",), 8),
    )
    rng = np.random.default_rng(4)
    with Recorder(path, cycle, truth if rig else None, layout if frames else None) as out:
        out.write_cycles(rng.standard_normal((30, cycle.size)))
        if rig:
            out.write_rig(rng.standard_normal((20, truth.size)))
        if frames:
            found = np.zeros(frames, record_dtype(8))
            found["id"] = np.arange(frames)
            out.write_frames(found.view(np.float64).reshape(frames, 3))
    return path


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write(tmp_path / "run.mcap")


def test_parquet_is_a_table_of_each_side(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target, rig = log.with_suffix(".parquet"), log.with_name("run-rig.parquet")
    assert run(["export", str(log), "-o", str(target)]) == 0
    assert capsys.readouterr().out == f"{target}\n{rig}\n"
    loaded = load(log)
    for path, topic, count in ((target, "/cycle", 30), (rig, "/rig", 20)):
        table = pq.read_table(path)
        assert table.num_rows == count
        assert table.column_names == list(loaded.columns(topic))
        for name, values in loaded.columns(topic).items():
            np.testing.assert_array_equal(table[name].to_numpy(), values)


def test_csv_reads_back_exactly(log: Path) -> None:
    assert run(["export", str(log), "-o", str(log.with_suffix(".csv"))]) == 0
    for name, topic in (("run.csv", "/cycle"), ("run-rig.csv", "/rig")):
        path = log.with_name(name)
        table = np.genfromtxt(path, delimiter=",", names=True, deletechars="")
        columns = load(log).columns(topic)
        assert table.dtype.names == tuple(columns)
        for field, values in columns.items():
            np.testing.assert_array_equal(table[field], values)


def test_npz_has_both_in_one_file(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = log.with_suffix(".npz")
    assert run(["export", str(log), "-o", str(target), "--to", "npz"]) == 0
    assert capsys.readouterr().out == f"{target}\n"
    with np.load(target) as found:
        assert found["cycle/tau_cmd_a_1"].shape == (30,)
        np.testing.assert_array_equal(found["rig/rho_a_1"], load(log).columns("/rig")["rho_a_1"])


def test_without_a_rig_there_is_one_table(tmp_path: Path) -> None:
    log = write(tmp_path / "run.mcap", rig=False)
    assert run(["export", str(log), "-o", str(log.with_suffix(".csv"))]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"run.mcap", "run.csv"}


def test_frames_of_csv_are_asked_for_by_name(log: Path) -> None:
    target = log.with_suffix(".csv")
    assert run(["export", str(log), "-o", str(target), "--to", "can-csv"]) == 0
    assert [m.arbitration_id for m in can.LogReader(target)] == [0, 1, 2, 3, 4]


def test_the_ending_says_which(log: Path) -> None:
    target = log.with_suffix(".log")
    assert run(["export", str(log), "-o", str(target)]) == 0
    assert target.read_text().startswith("(0.000000) can0 000# R\n")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["-o", "x.xyz"], "x.xyz: an ending '.xyz' of no format (expected .parquet, .csv, .npz, "),
        (["-o", "x"], "x: an ending '' of no format"),
        (["-o", "x.blf", "--to", "asc"], "x.blf: an ending '.blf' (expected '.asc' of asc)"),
        (["-o", "x.blf", "--to", "pcap"], "--to: 'pcap' (expected parquet, csv, npz, candump, "),
        (["-o", "none/x.asc"], "none/x.asc: cannot be written: No such file or directory"),
        (["-o", "folder.asc"], "folder.asc: is a folder"),
    ],
)
def test_what_cannot_be_is_one_line(
    arguments: list[str],
    told: str,
    log: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(log.parent)
    Path("folder.asc").mkdir()
    assert run(["export", "run.mcap", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith(f"dftc: {told}")


def test_logs_that_cannot_be_exported(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(log.parent)
    write(Path("plain.mcap"), frames=0)
    Path("torn.mcap").write_bytes(log.read_bytes()[:-1])
    Path("notes.mcap").write_text("no log")
    for name, told in (
        (
            "plain.mcap",
            "plain.mcap: no topic /can (expected a log that was recorded with --frames)",
        ),
        (
            "torn.mcap",
            "torn.mcap: torn, its writer was cut off (expected a whole log; dftc recover",
        ),
        ("notes.mcap", "notes.mcap: no MCAP file"),
        ("none.mcap", "none.mcap: No such file or directory"),
    ):
        assert run(["export", name, "-o", "x.log"]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert err.startswith(f"dftc: {told}")
        assert not Path("x.log").exists()
    assert run(["export", "plain.mcap", "-o", "x.npz"]) == 0


def test_the_log_itself_is_not_written_to(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = log.with_suffix(".csv")
    target.symlink_to(log)
    before = log.read_bytes()
    assert run(["export", str(log), "-o", str(target)]) == 2
    assert "the log itself" in capsys.readouterr().err
    assert log.read_bytes() == before


def test_a_missing_library_is_told_with_how_to_get_it(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    target = log.with_suffix(".parquet")
    assert run(["export", str(log), "-o", str(target)]) == 3
    assert capsys.readouterr().err == (
        "dftc: pyarrow is not installed; pip install 'dftc_rt[tables]'\n"
    )
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(OSError, match="pandas is not installed; pip install"):
        load(log).frame()


@pytest.mark.parametrize(
    ("form", "name", "make"),
    [
        ("foxglove", "view.json", viewer_layouts.foxglove_layout),
        ("plotjuggler", "view.xml", viewer_layouts.plotjuggler_layout),
    ],
)
def test_a_layout_is_of_the_joints_of_the_log(
    form: str, name: str, make: Callable[[Sequence[str]], str], log: Path, tmp_path: Path
) -> None:
    file = tmp_path / name
    assert run(["export", str(log), "--to", form, "-o", str(file)]) == 0
    assert file.read_text() == make(load(log).joints)
    by_ending = tmp_path / f"again{file.suffix}"
    assert run(["export", str(log), "-o", str(by_ending)]) == 0
    assert by_ending.read_bytes() == file.read_bytes()
