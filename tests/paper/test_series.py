"""The series: columns with units, and the curves' numbers."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from dftc_rt.paper import series
from dftc_rt.paper.runs import CURVE_S, Drawn, slug, thin
from dftc_rt.paper.variant import Variant
from tests.paper import synthetic


def read(path: Path) -> tuple[list[str], np.ndarray]:
    with path.open(newline="", encoding="utf-8") as stream:
        head, *rows = csv.reader(stream)
    return head, np.array(rows, dtype=float)


def test_a_file_for_every_figure(tmp_path: Path) -> None:
    drawn = Drawn((2,))
    curves = synthetic.curves(drawn)
    files = series.write_all(curves, drawn, tmp_path)
    assert [path.name for path in files] == [f"figure{n:02d}.csv" for n in range(6, 11)]
    for path in files:
        head, rows = read(path)
        assert head[0] == "t (s)"
        assert all(name.endswith((" (s)", " (rad)", " (rad/s)", " (Nm)", " (1)")) for name in head)
        assert rows.shape == (1001, len(head))
        np.testing.assert_allclose(np.diff(rows[:, 0]), CURVE_S, rtol=1e-6)
    head, rows = read(files[1])
    run = curves[slug(Variant(2))]
    np.testing.assert_allclose(rows[:, head.index("q2 (rad)")], run.q[:, 1], rtol=1e-8)
    np.testing.assert_allclose(rows[:, head.index("rho1 (1)")], run.rho)
    desired = rows[:, head.index("q1_desired (rad)")]
    np.testing.assert_allclose(desired, np.sin(run.t), atol=1e-8)
    head, rows = read(files[3])
    assert head[1] == "rho1 (1)"
    assert len(head) == 2 + 5


def test_an_estimate_that_ends_early_is_nan() -> None:
    run = synthetic.solution(Variant(2, gain="desired"))
    read_in = dict.fromkeys(("desired", "frozen", "fitted"), run)
    read_in["true_rho"] = synthetic.solution(Variant(2, gain="true_rho"))
    read_in["measured"] = thin(synthetic.solution(Variant(2, gain="measured")))  # a tenth
    columns = series.effectiveness(read_in)
    lengths = {len(column) for column in columns.values()}
    assert lengths == {1001}
    assert np.isnan(columns["rho1_hat_measured (1)"][101:]).all()


def test_thinned_to_a_hundred_samples_a_second() -> None:
    run = synthetic.solution(Variant(2), step_s=1e-3)
    few = thin(run)
    assert few.t == pytest.approx(np.arange(1001) * CURVE_S)
    np.testing.assert_array_equal(few.q, run.q[::10])
