"""docs/theory.md, "Where each equation is computed": the functions exist and cite the equation."""

import importlib
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

THEORY = Path(__file__).parents[2] / "docs" / "theory.md"
PRINTED = [3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 18, 21, 22, 23, 27, 28, 29, 33]
"""What has to be in the table: (3)-(14) but for the definition (5), (18)-(23), (27)-(29), (33)."""


def _rows() -> list[tuple[list[int], list[str]]]:
    section = THEORY.read_text(encoding="utf-8").split("## 11. Where each equation is computed")[1]
    rows = []
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| (") and len(cells) == 3:
            numbers = [int(n) for n in re.findall(r"\((\d+)\)", cells[0])]
            rows.append((numbers, re.findall(r"`((?:dftc_rt|hil)[\w.]+)`", cells[2])))
    return rows


def _find(path: str) -> Any:
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError:
        module, _, name = path.rpartition(".")
        return getattr(importlib.import_module(module), name)


@pytest.mark.parametrize(("numbers", "paths"), _rows())
def test_each_function_exists_and_cites_its_equation(numbers: list[int], paths: list[str]) -> None:
    assert paths, numbers
    cited: set[int] = set()
    for path in paths:
        found = _find(path)
        doc = found.__doc__ or ""
        if isinstance(found, ModuleType) or "(" not in doc:
            doc += importlib.import_module(getattr(found, "__module__", path)).__doc__ or ""
        here = {int(n) for n in re.findall(r"\((\d+)\)", doc)}
        for first, last in re.findall(r"\((\d+)\)-\((\d+)\)", doc):
            here |= set(range(int(first), int(last) + 1))
        assert here & set(numbers), f"{path} cites {sorted(here)}, not {numbers}"
        cited |= here
    assert set(numbers) <= cited, f"{numbers} are not all cited by {paths}"


def test_every_printed_equation_has_a_row() -> None:
    listed = {n for numbers, _ in _rows() for n in numbers}
    assert set(PRINTED) <= listed
