"""What docs/security.md says of the code, asked of the code."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

from dftc_rt.log import live

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "security.md").read_text()
UNPACKERS = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve", "joblib"}
SERVERS = {"http", "socketserver", "asyncio", "xmlrpc"}
PORTS = "dftc_rt/log/live.py"
PAGE_SERVER = "dftc_rt/view/server.py"
IMPORTERS = {"dftc_rt/control/plugin.py", "dftc_rt/drives/interface.py", "dftc_rt/cli/main.py"}


def modules() -> Iterator[tuple[str, ast.Module]]:
    for package in ("dftc_rt", "hil"):
        for path in sorted((ROOT / package).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), ast.parse(path.read_text())


def imported(tree: ast.Module) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.partition(".")[0])
    return names


def called(tree: ast.Module) -> set[str]:
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return {c.id if isinstance(c, ast.Name) else getattr(c, "attr", "") for c in calls}


def test_nothing_is_unpickled_and_nothing_evaluated() -> None:
    for where, tree in modules():
        assert not imported(tree) & UNPACKERS, where
        calls = {c.func.id for c in ast.walk(tree)
                 if isinstance(c, ast.Call) and isinstance(c.func, ast.Name)}  # fmt: skip
        assert not calls & {"eval", "exec", "compile", "__import__"}, where


def test_modules_are_imported_by_name_in_three_places_only() -> None:
    found = {where for where, tree in modules() if "import_module" in called(tree)}
    assert found == IMPORTERS


def test_a_network_port_is_opened_in_one_place_only_and_on_this_machine_only() -> None:
    for where, tree in modules():
        assert where == PAGE_SERVER or not imported(tree) & {"viser", "websockets"}, where
        assert not imported(tree) & SERVERS, where
        names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        opening = names & {"AF_INET", "AF_INET6", "create_server", "start_server", "start_gateway"}
        assert not opening or where == PORTS, where
    assert live.HOST == "127.0.0.1"
    tree = dict(modules())[PORTS]
    (started,) = (
        node for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "start_server"
    )  # fmt: skip
    given = {keyword.arg: ast.unparse(keyword.value) for keyword in started.keywords}
    assert given["host"] == "HOST"
    assert not given.keys() & {"capabilities", "services", "asset_handler"}  # it can only stream


def test_no_shipped_scenario_names_code() -> None:
    for path in (ROOT / "hil" / "scenarios").glob("*.toml"):
        control = tomllib.loads(path.read_text()).get("control", {})
        assert ":" not in control.get("law", "dftc"), path.name


def test_every_test_that_the_page_names_is_there() -> None:
    named = re.findall(r"`(tests/[\w./]+)`", PAGE)
    assert len(named) > 5
    for name in named:
        assert (ROOT / name).exists(), name
