"""What users can type is documented, and what is documented as there is there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args, get_origin

import msgspec
import pytest

from dftc_rt.cli.main import build
from dftc_rt.config.scenario import Scenario
from dftc_rt.control import laws, settings, signals
from dftc_rt.log.schema import cycle_layout, rig_layout

DOCS = Path(__file__).parents[2] / "docs"
CONTRACT = (DOCS / "contract.md").read_text(encoding="utf-8")
NOTATION = (DOCS / "notation.md").read_text(encoding="utf-8")
LINKED = re.compile(r"\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)")


def section(title: str) -> str:
    """Return the text of the section of the contract whose heading starts with ``title``."""
    found = re.search(
        rf"^(#+) {re.escape(title)}.*?(?=^#{{1,2}} |^### |\Z)", CONTRACT, re.MULTILINE | re.DOTALL
    )
    assert found, f"docs/contract.md has no section {title!r}"
    return found[0]


def keys(text: str) -> set[str]:
    """Return the keys in the first column of the tables of ``text``."""
    rows = re.findall(r"^\| (.*?) \|", text, re.MULTILINE)
    return {key for row in rows for key in re.findall(r"`(\w+)`", row)}


def structs(type_: Any) -> list[type[msgspec.Struct]]:
    """Return the structs that a field's type holds, tuples and unions opened."""
    if get_origin(type_) is not None:
        return [s for part in get_args(type_) for s in structs(part)]
    is_struct = isinstance(type_, type) and issubclass(type_, msgspec.Struct)
    return [type_] if is_struct else []


def tables(type_: type[msgspec.Struct], path: str = "") -> list[tuple[str, set[str]]]:
    """Return (path, keys that are no tables) of a struct and of every table below it."""
    here: set[str] = set()
    found = [(path, here)]
    for field in msgspec.structs.fields(type_):
        below = structs(field.type)
        if not below:
            here.add(field.encode_name)
        elif path or field.encode_name != "fault":
            found += tables(below[0], f"{path}.{field.encode_name}".lstrip("."))
    return [(name, values) for name, values in found if values]


@pytest.mark.parametrize(("path", "expected"), tables(Scenario))
def test_scenario_keys_are_documented(path: str, expected: set[str]) -> None:
    assert keys(section(f"`[{path}]`" if path else "Scenario file")) == expected


def test_faults_are_documented() -> None:
    text = section("`[[fault]]`")
    (faults,) = (
        structs(f.type) for f in msgspec.structs.fields(Scenario) if f.encode_name == "fault"
    )
    own, parameters = {"joint", "kind", "start_s", "end_s"}, {}
    for fault in faults:
        names = {f.encode_name for f in msgspec.structs.fields(fault)}
        parameters[str(fault.__struct_config__.tag)] = names - own
    documented = {
        kind: set(re.findall(r"`(\w+)`", used))
        for kind, used in re.findall(
            r"^\| `(\w+)` \| ((?:`\w+`.*?)?) ?\| .* \|$", text, re.MULTILINE
        )
        if kind in parameters
    }
    assert documented == parameters
    assert own <= keys(text)


def usage() -> dict[str, str]:
    """Return the row of each documented command."""
    groups = "|".join({name.split()[0] for name in COMMANDS if " " in name})
    rows = re.findall(rf"^\| `dftc ((?:(?:{groups}) )?\w+)(.*)$", CONTRACT, re.MULTILINE)
    assert len(rows) == len(dict(rows))
    return dict(rows)


def commands(app: Any, group: str = "") -> list[str]:
    """Return the names of an application's commands, those of its groups as two words."""
    found = []
    for name in app:
        if not name.startswith("-"):
            found += commands(app[name], f"{name} ") or [group + name]
    return sorted(found)


COMMANDS = commands(build())


def test_commands_are_documented() -> None:
    built = {name for name, row in usage().items() if "*planned*" not in row}
    assert built == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_an_example_and_the_documented_options(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    build()([*name.split(), "--help"])
    first, _, text = capsys.readouterr().out.strip().partition("\n")
    assert first.startswith(f"Usage: dftc {name}")
    documented = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", usage()[name].partition("` |")[0]))
    offered = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", text))
    assert documented - offered == set()
    assert f"dftc {name}" in text


def test_record_fields_are_documented() -> None:
    text = section("Log")
    for layout in (cycle_layout(("j",), signals.NAMES), rig_layout(("j",))):
        for field in layout.fields:
            assert f"`{field.removesuffix('j')}`" in text, f"{layout.topic}: {field}"
    for number, verdict in signals.VERDICTS.items():
        assert f"| {number} | {verdict} |" in text


def test_laws_are_documented() -> None:
    row = re.search(r"^\| `law` \| .*? \| (.*) \|$", CONTRACT, re.MULTILINE)
    assert row
    built = row[1].partition("*planned*")[0]
    assert set(re.findall(r"`([\w.:]+)`", built)) == {*laws.NAMES, "module:Class"}


def test_gains_are_documented() -> None:
    every = (*settings.NUMBERS, *settings.CHOICES, *settings.SHAPE)
    missing = [s.name for s in every if f"`{s.name}`" not in NOTATION]
    assert missing == []


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    prose = re.sub(r"^ {4}.*$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    for target, anchor in LINKED.findall(prose):
        path = (page.parent / target).resolve() if target else page
        assert path.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", h).lower().replace(" ", "-") for h in headings}


def test_citations_resolve() -> None:
    known = set(re.findall(r"^\| \[(\w+)\]", (DOCS / "references.md").read_text("utf-8"), re.M))
    root = DOCS.parent
    pages = [*DOCS.glob("*.md"), *root.glob("dftc_rt/**/*.py"), *root.glob("hil/**/*.py")]
    cited = {
        key for page in pages for key in re.findall(r"\[([a-z]+\d{4})\]", page.read_text("utf-8"))
    }
    assert cited - known == set()
    assert "zhao2017" in cited
