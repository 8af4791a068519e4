"""The further studies as tasks of the command's workers, a few runs of each."""

from __future__ import annotations

import pytest

from dftc_rt.paper import discrete_cases, fit_rows, search_space, studies


def test_other_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    few = search_space.space(quick=True)
    monkeypatch.setattr(search_space, "space", lambda: few)
    study = studies.searched((2,))
    assert study.tasks
    assert all(task.arguments[0].example == 2 for task in study.tasks)
    first = study.tasks[0]
    alone = studies.Study(study.key, study.title, (first,))
    results = {first.name: first.function(*first.arguments), "another task": None}
    (row,) = alone.plain(results)
    assert row["example"] == 2
    page = alone.markdown(results)
    assert "- Figures 6, 7 and 10: none of 1 readings." in page
    assert "of 0 readings" not in page  # nothing of the other example was run
    assert page.count("\n| 2 |") == 1


def test_discrete_time(monkeypatch: pytest.MonkeyPatch) -> None:
    few = discrete_cases.cases((1, 2), quick=True)
    asked = []
    monkeypatch.setattr(discrete_cases, "cases", lambda examples: asked.append(examples) or few[:2])
    study = studies.discretised((1, 2))
    assert asked == [(1, 2)]
    assert len({task.name for task in study.tasks}) == 2
    results = {task.name: task.function(*task.arguments) for task in study.tasks}
    plain = study.plain(results)
    assert len(plain["rows"]) == 2
    assert "Each cell is one run." in study.markdown(results)


def test_other_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    row = fit_rows.FitRow(1, "x_i alone", "rich", 10.0, 5.0, 0.3, 0.1, 0.2, 0.04)
    monkeypatch.setattr(fit_rows, "compare", lambda number: [row, row][:number])
    study = studies.fitted((1, 2))
    results = {task.name: task.function(*task.arguments) for task in study.tasks}
    assert [each["rho_rmse"] for each in study.plain(results)] == [0.04] * 3
    assert study.markdown(results).count("x_i alone") == 3
