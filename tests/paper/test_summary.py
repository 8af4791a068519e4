"""What the paper's figures come to: one run of the command, and the page that reports it."""

from __future__ import annotations

import json
import re
from itertools import pairwise

import pytest

from dftc_rt.paper.verdicts import CONDITIONAL, DOES_NOT, REPRODUCES
from tests.paper.conftest import PaperRun
from tests.paper.page import IMAGES, PAGE, page

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
_RELATIVE = 0.1  # other versions of the solver and of the machine's arithmetic choose other steps
_ABSOLUTE = 2e-3  # of what is nearly nothing: mrad, rad/s and RMSE alike


def test_verdicts(paper_run: PaperRun) -> None:
    verdicts = {f["figure"]: f["verdict"] for f in paper_run.summary["figures"]}
    assert verdicts == {
        1: REPRODUCES, 2: DOES_NOT, 3: REPRODUCES, 4: DOES_NOT, 5: REPRODUCES,
        6: REPRODUCES, 7: DOES_NOT, 8: REPRODUCES, 9: CONDITIONAL, 10: REPRODUCES,
    }  # fmt: skip
    (ninth,) = (f for f in paper_run.summary["figures"] if f["figure"] == 9)
    assert ninth["conditions"] == ["the true ρ in (27), which a robot does not have"]
    assert paper_run.summary["failed"] == {}


def test_our_estimate_reaches_what_it_is_to_reach(paper_run: PaperRun) -> None:
    targets = paper_run.summary["targets"]
    assert [(t["example"], t["limit"]) for t in targets] == [
        (1, 0.005), (1, 0.02), (1, 0.02), (2, 0.005), (2, 0.02), (2, 0.02),
    ]  # fmt: skip
    assert all(t["met"] and t["number"] <= t["limit"] for t in targets)


def test_epsilon_sets_the_tracking_error(paper_run: PaperRun) -> None:
    first = paper_run.summary["figures"][0]
    rms = {row["title"].split(",")[0]: row["detail"]["RMS 1/mrad"] for row in first["rows"]}
    ordered = [rms[f"ε = {e}"] for e in ("0.1", "0.01", "0.001")]
    assert all(larger > 2 * smaller for larger, smaller in pairwise(ordered))


def test_the_summary_in_the_folder_is_the_one_on_stdout(paper_run: PaperRun) -> None:
    written = json.loads((paper_run.folder / "summary.json").read_text("utf-8"))
    assert written == paper_run.summary
    assert paper_run.stdout.count("\n") == 1
    assert "Traceback" not in paper_run.stderr
    assert "| [10](#fig-10) | both joints" in (paper_run.folder / "summary.md").read_text("utf-8")
    expected = {f"figure{n:02d}.{end}" for n in range(1, 11) for end in ("png", "svg", "csv")}
    expected |= {"summary.json", "summary.md"}
    assert {path.name for path in paper_run.folder.iterdir()} == expected


def test_the_page_says_what_a_fresh_run_says(paper_run: PaperRun) -> None:
    fresh = page(paper_run.summary).splitlines()
    kept = PAGE.read_text("utf-8").splitlines()
    assert len(fresh) == len(kept)
    for new, old in zip(fresh, kept, strict=True):
        if old.startswith("Versions"):
            continue
        assert _NUMBER.sub("#", new) == _NUMBER.sub("#", old)
        numbers = [[float(x) for x in _NUMBER.findall(line)] for line in (new, old)]
        assert numbers[0] == pytest.approx(numbers[1], rel=_RELATIVE, abs=_ABSOLUTE), old


def test_every_figure_of_the_page_is_there_and_small() -> None:
    shown = re.findall(r"\]\(images/paper/(.*?\.png)\)", PAGE.read_text("utf-8"))
    assert shown == [f"figure{n:02d}.png" for n in range(1, 11)]
    assert all((IMAGES / name).stat().st_size < 100_000 for name in shown)
