"""Summary, report and figure of a run."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from dftc_rt.analysis import summary
from dftc_rt.analysis.figures import fault_figure, save
from dftc_rt.analysis.metrics import evaluate
from dftc_rt.analysis.report import write_report
from dftc_rt.errors import InputError, LogError
from dftc_rt.log.run import Run
from dftc_rt.ring import Event
from dftc_rt.rt.supervisor import State

from .conftest import Maker

SCENARIO = (
    '[robot]\nname = "pan<da"\n[control]\nlaw = "dftc"\nftc = true\n'
    '[[fault]]\njoint = "a"\nkind = "loss"\nstart_s = 4.0\neffectiveness = 0.6\n'
)


@pytest.fixture
def run(make: Maker) -> Run:
    run = make(SCENARIO, torque_limit=(10.0, 10.0), events=(Event(4.0, 3, "can0", "<b>off</b>"),))
    assert run.rig is not None
    run.rig["rho"][400:, 0] = 0.6
    run.cycle["rho_hat"][430:, 0] = 0.6
    run.cycle["verdict"][420:, 0] = 1.0
    run.cycle["qd"][450:, 0] = 0.00312
    run.cycle["lateness"][:] = 4e-5
    run.cycle["state"][-1] = State.FINISH
    return run


def printed(metrics: dict[str, Any], width: int = 80) -> str:
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    with console.file:
        summary.show(metrics, console)
        return console.export_text()


def test_sentence_says_how_it_ended_and_what_the_fault_did(run: Run, make: Maker) -> None:
    assert summary.verdict(evaluate(run, twin=make())) == (
        "The run went to its end: a (loss to 60 % at 4.00 s) was detected after 0.20 s and "
        "tracked to 3.12 mrad RMS in the fault against 0.00 without it."
    )
    run.cycle["verdict"][:] = 0.0
    run.cycle["verdict"][100:110, 1] = 1.0
    assert "was not detected" in summary.verdict(evaluate(run))
    assert "; 1 false alarm." in summary.verdict(evaluate(run))


def test_sentence_of_a_run_without_faults(make: Maker) -> None:
    run = make()
    run.cycle["qd"][:, 1] = 0.002
    assert summary.verdict(evaluate(run, end_state="done")) == (
        "The run went to its end: no joint had a fault; tracking error up to 2.00 mrad RMS."
    )


def test_table_has_a_row_per_joint_and_fits_80_columns(run: Run) -> None:
    text = printed(evaluate(run))
    rows = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line[:2] in
            ("a ", "b ")}  # fmt: skip
    assert rows["a"] == ["0.00", "3.12", "3.1", "0.000", "0.29", "0.200", "0", "0.0", "0.0"]
    assert rows["b"] == ["0.00", "0.00", "0.0", "0.000", "–", "–", "0", "0.0", "0.0"]
    assert "lateness 40 / 40 / 40 / 40" in text
    assert "…" not in text


def test_sentence_says_why_it_stopped(make: Maker) -> None:
    stop = Event(9.9, 3, "controller", "safe stop: b: tracking error over 0.5 rad")
    run = make(events=(stop,))
    told = "The run ended in a safe stop (b: tracking error over 0.5 rad): no joint had a fault"
    assert summary.verdict(evaluate(run)).startswith(told)


def test_in_lock_step_nothing_is_late(run: Run) -> None:
    run.cycle["lateness"][:] = 0.0
    run.cycle["compute"][:] = 5e-5
    text = printed(evaluate(run))
    assert "1000 cycles in lock-step; update 50 / 50 / 50 / 50" in text
    assert "lateness" not in text
    assert "overruns" not in text


class Page(HTMLParser):
    """Collects what a browser would show and fetch."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str | None] = []
        self.text = ""
        self.scripts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        if self.tags and self.tags[-1] == "script":
            self.scripts.append(data)
        else:
            self.text += data


def traces(page: Page, div: str) -> list[dict[str, Any]]:
    """The curves of one figure, as plotly.js gets them."""
    script = next(s for s in page.scripts if re.search(rf'newPlot\(\s*"{div}"', s))
    start = script.index("[{")
    found: list[dict[str, Any]] = json.JSONDecoder().raw_decode(script, start)[0]
    return found


def values(trace: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(trace["y"]["bdata"]), trace["y"]["dtype"])


def test_report_is_one_file_that_shows_the_run(run: Run, tmp_path: Path) -> None:
    write_report(run, evaluate(run), tmp_path / "r.html")
    page = Page((tmp_path / "r.html").read_text())
    assert page.links == []  # nothing is fetched
    assert "was detected after 0.20 s" in page.text
    assert "pan<da" in page.text
    assert "<b>off</b>" in page.text  # shown, not obeyed
    assert "b" not in page.tags
    curves = {trace.get("name"): trace for trace in traces(page, "joint0")}
    assert curves.keys() >= {"error", "ρ̂", "ρ (true)", "± 2σ", "law", "sent", "applied"}
    assert values(curves["error"]).max() == pytest.approx(3.12)
    assert values(curves["ρ (true)"]).min() == pytest.approx(0.6)
    assert values(curves["± 2σ"]).max() == pytest.approx(1.02)
    names = {trace["name"] for trace in traces(page, "timing")}
    assert names == {"lateness", "lateness, percentiles"}
    marks = traces(page, "timing")[1]
    assert marks["text"] == ["p50", "p99", "p99.9", "max"]
    assert np.frombuffer(base64.b64decode(marks["x"]["bdata"])) == pytest.approx([40.0] * 4)
    assert "lateness40.040.040.040.0" in page.text  # the same as a table


def test_the_error_of_a_joint_whose_drive_is_off_is_none(run: Run, tmp_path: Path) -> None:
    run.cycle["qd"][900:, 0] = 1.0
    run.cycle["state"][900:] = State.FAULT
    write_report(run, evaluate(run), tmp_path / "r.html")
    curves = traces(Page((tmp_path / "r.html").read_text()), "joint0")
    error = values(next(trace for trace in curves if trace.get("name") == "error"))
    assert np.nanmax(error) == pytest.approx(3.12)


def test_the_strip_of_verdicts_shows_the_gravest_of_many(run: Run, tmp_path: Path) -> None:
    run.cycle["verdict"][:, 1] = 4.0
    run.cycle["verdict"][700:720, 1] = 7.0
    run.cycle["verdict"][710, 1] = 1.0
    write_report(run, evaluate(run), tmp_path / "r.html")
    page = Page((tmp_path / "r.html").read_text())
    strip = {trace.get("name"): trace for trace in traces(page, "joint1")}

    def spans(name: str) -> np.ndarray:
        x = strip[name]["x"]
        return np.frombuffer(base64.b64decode(x["bdata"]), x["dtype"]).reshape(-1, 3)[:, :2]

    assert spans("actuator loss") == pytest.approx(np.array([[7.10, 7.11]]), abs=0.011)
    assert spans("anomaly not yet attributed")[0, 0] == pytest.approx(7.0, abs=0.011)
    assert spans("not observable")[-1, 1] == pytest.approx(9.99, abs=0.011)
    assert spans("not observable").shape == (2, 2)
    (events,) = traces(page, "events")
    assert (events["name"], events["text"]) == ("error", ["&lt;b&gt;off&lt;/b&gt;"])


def test_the_same_run_gives_the_same_report(run: Run, tmp_path: Path) -> None:
    for name in ("1.html", "2.html"):
        write_report(run, evaluate(run), tmp_path / name)
    assert (tmp_path / "1.html").read_bytes() == (tmp_path / "2.html").read_bytes()


def test_report_of_a_run_without_rig_or_estimate(make: Maker, tmp_path: Path) -> None:
    run = make(rig=False)
    run.cycle["rho_hat"][:] = np.nan
    write_report(run, evaluate(run), tmp_path / "r.html")
    page = Page((tmp_path / "r.html").read_text())
    names = {trace["name"] for trace in traces(page, "joint1")}
    assert names == {"error", "law", "sent", "residual", "healthy"}


def test_a_minute_of_seven_joints_stays_under_8_mb(tmp_path: Path) -> None:
    from dftc_rt.control.signals import NAMES
    from dftc_rt.log.schema import cycle_layout, rig_layout

    joints = [f"j{i}" for i in range(7)]
    cycle, rig = cycle_layout(joints, NAMES), rig_layout(joints)
    rng = np.random.default_rng(1)
    cycles, rigs = rng.random((60_000, cycle.size)), rng.random((60_000, rig.size))
    cycles[:, 0] = rigs[:, 0] = np.arange(60_000) / 1000
    big = Run.from_records(cycle, cycles, rigs)
    write_report(big, evaluate(big), tmp_path / "r.html")
    assert (tmp_path / "r.html").stat().st_size < 8_000_000


def test_a_place_that_cannot_be_written_is_told(run: Run, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be written"):
        write_report(run, evaluate(run), tmp_path / "none" / "r.html")


def test_figure_shows_error_and_estimate_around_the_fault(
    run: Run, make: Maker, tmp_path: Path
) -> None:
    figure = fault_figure(run, others={"twin": make(), "no gain": run}, after_s=3.0)
    top, bottom = figure.axes
    lines = {line.get_label(): line for line in top.get_lines()}
    assert lines.keys() >= {"with the gain 1/ρ̂", "twin", "no gain"}
    assert lines["with the gain 1/ρ̂"].get_ydata().max() == pytest.approx(3.12)
    assert bottom.get_xlim() == (2.0, 7.0)
    truth = next(line for line in bottom.get_lines() if line.get_label() == "ρ (true)")
    assert set(truth.get_ydata()) == {1.0, 0.6}
    save(figure, tmp_path / "1.png")
    assert (tmp_path / "1.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with pytest.raises(InputError, match=r"\.gif"):
        save(figure, tmp_path / "x.gif")


def test_the_same_run_gives_the_same_figure(run: Run, tmp_path: Path) -> None:
    for name in ("1.svg", "2.svg"):
        save(fault_figure(run), tmp_path / name)
    assert (tmp_path / "1.svg").read_bytes() == (tmp_path / "2.svg").read_bytes()


def test_figure_needs_a_fault(run: Run, make: Maker) -> None:
    with pytest.raises(InputError, match="no fault on any joint"):
        fault_figure(make())
    with pytest.raises(InputError, match="no fault on b"):
        fault_figure(run, joint="b")
