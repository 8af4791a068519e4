"""Runs side by side."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.analysis.comparison import check_same_robot, compared, write_comparison
from dftc_rt.analysis.figures import joint_figure, joint_to_show, save
from dftc_rt.analysis.metrics import evaluate
from dftc_rt.control.signals import NAMES
from dftc_rt.errors import InputError
from dftc_rt.log.run import Run
from dftc_rt.log.schema import cycle_layout, rig_layout

from .conftest import Maker
from .test_presentation import Page, traces, values

SCENARIO = (
    '[robot]\nname = "arm"\n[control]\nlaw = "dftc"\nftc = {}\n'
    '[[fault]]\njoint = "b"\nkind = "loss"\nstart_s = 4.0\neffectiveness = 0.6\n'
)


@pytest.fixture
def pair(make: Maker) -> dict[str, Run]:
    runs = {
        "with": make(SCENARIO.format("true"), torque_limit=(10.0, 10.0)),
        "wi<thout": make(SCENARIO.format("false"), torque_limit=(10.0, 10.0), seconds=8.0),
    }
    runs["with"].cycle["qd"][:, 1] = 0.002
    runs["wi<thout"].cycle["qd"][:, 1] = 0.005
    runs["wi<thout"].cycle["verdict"][500:, 1] = 1.0
    return runs


def test_numbers_and_curves_are_side_by_side(pair: dict[str, Run], tmp_path: Path) -> None:
    write_comparison(pair, {k: evaluate(run) for k, run in pair.items()}, tmp_path / "c.html")
    page = Page((tmp_path / "c.html").read_text())
    assert page.links == []
    text = page.text.replace("\n", "")
    assert "wi<thout5.005.00" in text
    assert "against with× 2.5× 2.5× 2.5" in text
    assert "control.ftcTrueFalse" in text
    curves = {trace.get("name"): trace for trace in traces(page, "joint1")}
    assert values(curves["with"]).max() == pytest.approx(2.0)
    assert values(curves["wi<thout"]).max() == pytest.approx(5.0)
    assert curves.keys() >= {"ρ̂ with", "ρ̂ wi<thout", "± 2σ with", "sent with", "actuator loss"}
    strips = [values(t)[0] for t in traces(page, "joint1") if t.get("name") == "healthy"]
    assert strips == [0.0, -1.0]  # one below the other


def test_a_minute_of_seven_joints_twice_stays_under_8_mb(tmp_path: Path) -> None:
    joints = [f"j{i}" for i in range(7)]
    cycle, rig = cycle_layout(joints, NAMES), rig_layout(joints)
    runs = {}
    for seed in range(2):
        rng = np.random.default_rng(seed)
        cycles, rigs = rng.random((60_000, cycle.size)), rng.random((60_000, rig.size))
        cycles[:, 0] = rigs[:, 0] = np.arange(60_000) / 1000
        runs[f"run {seed}"] = Run.from_records(
            cycle, cycles, rigs, scenario='[control]\nlaw = "dftc"\n', torque_limit=[0.1] * 7
        )
    write_comparison(runs, {k: evaluate(run) for k, run in runs.items()}, tmp_path / "c.html")
    assert (tmp_path / "c.html").stat().st_size < 8_000_000


def test_runs_of_different_robots_are_refused(pair: dict[str, Run]) -> None:
    first = pair["with"]
    other = dataclasses.replace(pair["wi<thout"], joints=("a", "c"))
    with pytest.raises(InputError, match=r"x: another robot, with the joints a, c .*as in with"):
        check_same_robot({"with": first, "x": other})
    first, other = (dataclasses.replace(run, urdf=urdf) for run, urdf in
                    zip(pair.values(), ("<robot/>", "<robot name='2'/>"), strict=True))  # fmt: skip
    with pytest.raises(InputError, match="x: another robot, arm"):
        check_same_robot({"with": first, "x": other})
    with pytest.raises(InputError, match=r"logs to compare: 5 .*2 to 4"):
        check_same_robot({str(k): first for k in range(5)})


@pytest.mark.parametrize(
    ("key", "form", "ours", "theirs", "text"),
    [
        ("rmse_faulty_mrad", ".2f", 2.0, 5.0, "× 2.5"),
        ("rmse_faulty_mrad", ".2f", 0.0, 5.0, "–"),
        ("detection_delay_s", ".3f", 0.2, 0.15, "-0.050"),
        ("detection_delay_s", ".3f", None, 0.15, "–"),
        ("false_alarms", "d", 0, 3, "+3"),
        ("saturated_fraction", "%", 0.01, 0.03, "+2.0"),
    ],
)
def test_ratio_of_errors_and_difference_of_the_rest(
    key: str, form: str, ours: float | None, theirs: float | None, text: str
) -> None:
    assert compared(key, form, ours, theirs) == text


def test_a_figure_of_one_joint_of_both(pair: dict[str, Run], tmp_path: Path) -> None:
    assert joint_to_show(pair) == "b"
    figure = joint_figure(pair, "b", (3.0, 6.0))
    error, rho, torque, residual = figure.axes
    assert {line.get_label(): line.get_ydata().max() for line in error.get_lines()} == {
        "with": pytest.approx(2.0),
        "wi<thout": pytest.approx(5.0),
    }
    assert rho.get_xlim() == (3.0, 6.0)
    assert {line.get_label() for line in torque.get_lines()} == {"sent with", "sent wi<thout"}
    assert residual.get_ylabel() == "residual (Nm)"
    for suffix, start in ((".pdf", b"%PDF"), (".png", b"\x89PNG"), (".svg", b"<?xml")):
        save(figure, tmp_path / f"1{suffix}")
        assert (tmp_path / f"1{suffix}").read_bytes().startswith(start)


def test_a_figure_of_one_run_has_law_sent_and_applied(make: Maker) -> None:
    run = make()
    run.cycle["qd"][:, 1] = 0.001
    assert joint_to_show({"": run}) == "b"  # no fault: that of the largest error
    torque = joint_figure({"": run}, "a").axes[2]
    assert [line.get_label() for line in torque.get_lines()] == ["law", "sent", "applied"]
    with pytest.raises(InputError, match="--joint: 'z'"):
        joint_figure({"": run}, "z")
    with pytest.raises(InputError, match="--span: 20 to 30 s"):
        joint_figure({"": run}, "a", (20.0, 30.0))
