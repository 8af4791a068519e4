"""The table of docs/architecture.md is what the code does."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from grimp import ImportGraph

from tests.architecture.allow_list import parse, violations

ROOT = Path(__file__).parents[2]


def contract() -> dict[str, list[str]]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (found,) = project["tool"]["importlinter"]["contracts"]
    return {key: found[key] for key in ("arrows", "importers")}


def test_code_imports_only_what_the_table_allows() -> None:
    lint = "from importlinter.cli import lint_imports_command as c; c(['--no-cache'])"
    done = subprocess.run(
        [sys.executable, "-c", lint], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_document_and_contract_hold_the_same_table() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    documented = {}
    for place, _, allowed in re.findall(r"^\| `([\w/.]+)` \|(.*)\|(.*)\|$", text, re.MULTILINE):
        name = place.removesuffix("/").removesuffix(".py").replace("/", ".")
        documented[name] = {
            p.removesuffix("/").removesuffix(".py").replace("/", ".")
            for p in re.findall(r"`([\w/.]+)`", allowed)
        }
    assert documented == {k: set(v) for k, v in parse(contract()["arrows"], "->").items()}


def graph(*imports: tuple[str, str]) -> ImportGraph:
    built = ImportGraph()
    for importer, imported in imports:
        for module in (importer, imported):
            if module not in built.modules:
                built.add_module(module, is_squashed=False)
        built.add_import(importer=importer, imported=imported)
    return built


@pytest.mark.parametrize(
    ("importer", "imported"),
    [
        ("dftc_rt.control.law", "dftc_rt.dynamics.split"),
        ("dftc_rt.rt.executor", "hil.rig"),
        ("dftc_rt.bus.unix", "dftc_rt.log.schema"),
        ("hil.rig", "dftc_rt.log.recorder"),
        ("hil.rig", "dftc_rt.cli.main"),
        ("dftc_rt.control.law", "pinocchio"),
        ("dftc_rt.analysis.metrics", "mcap"),
        ("dftc_rt", "dftc_rt.errors"),
        ("dftc_rt.brand_new", "numpy"),
    ],
)
def test_forbidden_import_is_found(importer: str, imported: str) -> None:
    table = contract()
    found = violations(
        graph((importer, imported)), parse(table["arrows"], "->"), parse(table["importers"], "<-")
    )
    assert importer in {v.importer for v in found}


@pytest.mark.parametrize(
    ("importer", "imported"),
    [
        ("dftc_rt.cli.hil", "hil.rig"),
        ("dftc_rt.control.law", "dftc_rt.control.basis"),
        ("dftc_rt.dynamics.robot", "pinocchio"),
        ("hil.rig", "dftc_rt.log.schema"),
        ("hil.plants.robot", "pinocchio"),
    ],
)
def test_allowed_import_is_kept(importer: str, imported: str) -> None:
    table = contract()
    assert not violations(
        graph((importer, imported)), parse(table["arrows"], "->"), parse(table["importers"], "<-")
    )


def test_repeated_row_is_refused() -> None:
    with pytest.raises(ValueError, match="repeated"):
        parse(["a -> b", "a -> c"], "->")
