"""The drawings: files, axes, legends, and the same bytes for the same curves."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from dftc_rt.errors import EnvironmentLacksError
from dftc_rt.paper import figures
from dftc_rt.paper.runs import Drawn
from dftc_rt.paper.variant import Variant
from tests.paper import synthetic


def test_five_figures_twice_are_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = Drawn((2,))
    written = []
    for name, colour in (("one", "white"), ("two", "pink")):
        monkeypatch.setitem(matplotlib.rcParams, "axes.facecolor", colour)  # a matplotlibrc
        (tmp_path / name).mkdir()
        written.append(figures.draw_all(synthetic.curves(drawn), drawn, tmp_path / name))
    names = [f"figure{n:02d}.{end}" for n in range(6, 11) for end in ("png", "svg")]
    assert [path.name for path in written[0]] == names
    for one, two in zip(*written, strict=True):
        content = one.read_bytes()
        assert content == two.read_bytes()
        if one.suffix == ".png":
            assert content.startswith(b"\x89PNG\r\n\x1a\n")
            assert len(content) < 150_000
        else:
            text = content.decode()
            assert text.startswith("<?xml")
            assert "<dc:date>" not in text


def test_other_curves_are_other_bytes(tmp_path: Path) -> None:
    run = synthetic.solution(Variant(2))
    one = figures.save(figures.tracking(run, ""), tmp_path / "one")
    run.q[:, 0] += 0.3
    two = figures.save(figures.tracking(run, ""), tmp_path / "two")
    assert all(a.read_bytes() != b.read_bytes() for a, b in zip(one, two, strict=True))


@pytest.mark.parametrize(("example", "duration_s"), [(1, 40.0), (2, 10.0)])
def test_axes_and_legends_of_tracking(example: int, duration_s: float) -> None:
    run = synthetic.solution(Variant(example))
    axes = figures.tracking(run, "under the fault").axes
    assert len(axes) == 6
    assert all(each.get_xlim() == (0.0, duration_s) for each in axes)
    assert [text.get_text() for text in axes[1].get_legend().get_texts()] == [
        "$x_{21d}$", "$x_{21}$",
    ]  # fmt: skip
    desired, actual = axes[0].get_lines()[:2]
    np.testing.assert_array_equal(actual.get_ydata(), run.q[:, 0])
    np.testing.assert_array_equal(desired.get_ydata(), np.sin(run.t))
    np.testing.assert_allclose(axes[4].get_lines()[0].get_ydata(), 1e3 * run.error(0))
    assert axes[4].get_xlabel() == "t (s)"
    assert all(re.search(r"\((rad|mrad)\)", each.get_ylabel()) for each in axes)


def test_effectiveness_shows_the_paper_s_and_ours() -> None:
    drawn = Drawn((2,))
    read_in = figures.estimates(synthetic.curves(drawn), drawn, 2)
    upper, lower = figures.effectiveness(read_in).axes
    labels = [[t.get_text() for t in axes.get_legend().get_texts()] for axes in (upper, lower)]
    assert len(labels[0]) == 3
    assert "as written" in labels[0][0]
    assert sum("ours" in label for label in labels[1]) == 3
    assert labels[0][-1] == labels[1][-1] == r"$\rho_1$"


def test_ours_are_read_in_the_loop_of_the_gain_that_is_drawn() -> None:
    drawn = Drawn((2,), gain="frozen")
    read_in = figures.estimates(synthetic.curves(drawn), drawn, 2)
    assert {name: run.variant.gain for name, run in read_in.items()} == {
        "desired": "frozen", "frozen": "frozen", "fitted": "frozen", "measured": "measured",
        "true_rho": "true_rho",
    }  # fmt: skip


def test_without_matplotlib_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(EnvironmentLacksError, match=r"dftc_rt\[figures\]"):
        figures.require()
