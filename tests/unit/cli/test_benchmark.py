"""``dftc benchmark``: options, what is still to be run, and an interruption."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from dftc_rt.benchmark import negative
from dftc_rt.benchmark.cases import Group
from dftc_rt.benchmark.conditions import NEGATIVE_S, ROBOTS
from dftc_rt.benchmark.rows import FAULT_COLUMNS, FaultRow
from dftc_rt.benchmark.store import Store, load_faults
from dftc_rt.cli import benchmark_progress, benchmark_work
from dftc_rt.cli.benchmark_files import joints_of
from dftc_rt.cli.benchmark_work import Calibrations
from dftc_rt.cli.main import run as command
from dftc_rt.pool import Task
from tests.unit.benchmark.made_up import case, healthy

JOINTS = {"ur5": ("lift", "elbow", "wrist")}
GROUP = Group("ur5", "dftc", "desired", 1.0, "tuning", 1)
KNOWN = Calibrations({"ur5": "ur5.toml"}, {"ur5": "f"})


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--robot", "r2d2"], "--robot: found 'r2d2' (expected one of panda, ur5, ur10, xarm7)"),
        (["--law", "pd"], "--law: found 'pd'"),
        (["--kind", "loss"], "--kind: found 'loss'"),
        (["--interconnection", "none"], "--interconnection: found 'none'"),
        (["--robot", "ur5", "--joint", "panda_joint2"], "--joint: found 'panda_joint2'"),
        (["--seeds", "0"], "--seeds: found 0"),
        (["--hours", "-1"], "--hours: found -1"),
        (["--jobs", "0"], "--jobs: found 0"),
        (["--momentum-threshold", "0"], "--momentum-threshold: found 0"),
        (["--freeze", "--momentum-threshold", "2"], "--freeze: with --momentum-threshold"),
        (["--freeze", "--draw", "sealed"], "--freeze: with --draw sealed"),
        (["--draw", "sealed"], "frozen.toml: nothing is frozen yet"),
        (["--draw", "sealed", "--momentum-threshold", "2"], "--momentum-threshold: with --draw"),
        (["--part", "some"], "Invalid value"),
        (["--robot", "ur5", "--set", "control.colour=1"], "control.colour: unknown key"),
        (["--robot", "ur5", "--set", "control.gains.kay=1"], "control.gains.kay: unknown key"),
    ],
)
def test_bad_options_are_one_line_and_2(
    options: list[str], line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(["benchmark", "faults", "-o", str(tmp_path / "out"), *options]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out" / "calibration").exists()


def test_a_folder_that_is_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "file"
    path.write_text("x")
    assert command(["benchmark", "faults", "-o", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_joints_of_every_robot_are_in_its_file() -> None:
    assert [len(joints_of(robot)) for robot in ROBOTS] == [7, 6, 6, 7]


def twins(**changed: Any) -> list[FaultRow]:
    return [
        case(1, kind="twin", joint=joint, loaded=joint != "wrist",
             id=GROUP.case_id("twin", joint), **changed)
        for joint in JOINTS["ur5"]
    ]  # fmt: skip


def missing(
    rows: Sequence[FaultRow], kinds: Sequence[str] = ("loss40",), only: Sequence[str] = ()
) -> list[Any]:
    tasks = benchmark_work.fault_tasks([GROUP], kinds, JOINTS, only, rows, KNOWN)
    assert len(tasks) <= 1
    return list(tasks[0].arguments[4:]) if tasks else []


def test_before_the_twin_every_joint_may_be_loaded() -> None:
    every = [("loss40", joint) for joint in JOINTS["ur5"]]
    assert missing([]) == [every, True]
    assert missing(twins()[:2]) == [every, True]  # interrupted between its rows


def test_after_it_only_loaded_joints_are_left() -> None:
    assert missing(twins()) == [[("loss40", "lift"), ("loss40", "elbow")], False]


def test_what_is_there_is_not_run_again() -> None:
    done = case(1, joint="lift", id=GROUP.case_id("loss40", "lift"))
    assert missing([*twins(), done]) == [[("loss40", "elbow")], False]
    assert missing([*twins(), done], only=["lift"]) == []


def test_a_twin_that_was_stopped_has_no_cases() -> None:
    assert missing(twins(end_state="safe stop")) == []


def test_two_joints_need_two_that_are_loaded() -> None:
    alone = [*twins()[:1], *(row for row in twins()[1:])]
    assert missing(alone, ["two"])[0] == [("two", "lift"), ("two", "elbow")]
    one = [
        case(1, kind="twin", joint=joint, loaded=joint == "lift", id=GROUP.case_id("twin", joint))
        for joint in JOINTS["ur5"]
    ]
    assert missing(one, ["two"]) == []


def test_passes_make_up_the_hours() -> None:
    hour = 3600.0 / NEGATIVE_S
    assert benchmark_work.passes(0.0, 4, 21) == 1
    assert benchmark_work.passes(1.0, 1, int(hour)) == 1
    assert benchmark_work.passes(1.01, 1, int(hour)) == 2


def test_passes_have_seeds_of_their_own() -> None:
    items = negative.ITEMS[:3]

    def seeds(count: int) -> list[int]:
        tasks = benchmark_work.negative_tasks(
            ["ur5"], [("dftc", "desired", 1.0)], "tuning", count, items, [], KNOWN
        )
        return [task.arguments[0].seed for task in tasks]

    assert len(set(seeds(2))) == 6
    assert seeds(2)[:3] == seeds(1)
    done = healthy(seeds(1)[0], item=items[0].name)
    group = Group("ur5", "dftc", "desired", 1.0, "tuning", seeds(1)[0])
    rows = [healthy(item=done.item, id=negative.item_id(group, done.item))]
    tasks = benchmark_work.negative_tasks(
        ["ur5"], [("dftc", "desired", 1.0)], "tuning", 1, items, rows, KNOWN
    )
    assert len(tasks) == 2


def test_a_sweep_has_the_runs_of_dftc() -> None:
    rows = [healthy(k, item="hold") for k in (1, 2)]
    tasks = benchmark_work.sweep_tasks(rows, [], KNOWN)
    assert [task.arguments[0].variant for task in tasks] == ["momentum", "momentum"]
    assert [task.arguments[0].seed for task in tasks] == [1, 2]
    assert [task.arguments[4].name for task in tasks] == ["hold", "hold"]


def test_rows_are_kept_when_the_operator_stops_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "results.csv"

    def run(tasks: Sequence[Task], jobs: int, done: Callable[..., None], item: Any) -> None:
        item(tasks[0], case(2))
        raise KeyboardInterrupt

    monkeypatch.setattr(benchmark_work, "run", run)
    with pytest.raises(KeyboardInterrupt):
        benchmark_work.compute("faults", [Task("a", run)], path, FAULT_COLUMNS, [case(1)], 1)
    assert load_faults(path) == [case(1), case(2)]


def test_rows_of_other_sources_are_moved_aside_and_it_is_said(tmp_path: Path) -> None:
    path = tmp_path / "results.csv"
    rows = [case(1), case(2, fingerprint="old"), case(3, robot="panda", fingerprint="p")]
    Store(path, list(FAULT_COLUMNS), rows).close()
    said: list[str] = []
    kept = benchmark_work.current(path, FAULT_COLUMNS, rows, {"ur5": "f"}, said.append)
    assert kept == [rows[0], rows[2]]  # panda is not asked for now, and stays
    assert load_faults(tmp_path / "results.old.csv") == [rows[1]]
    assert said == ["1 rows of other sources or another calibration moved to results.old.csv"]


def test_progress_without_a_terminal_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(benchmark_progress.time, "monotonic", lambda: now[0])
    with benchmark_progress.Progress("faults", 3) as told:
        told.row()
        told.done()
        now[0] = 25.0
        told.row()
        told.done()
    assert capsys.readouterr().err == "dftc: faults, 2 rows: 1 of 3 groups, 25 s\n"
