"""The gallery's pictures and numbers are those of its commands."""

from __future__ import annotations

import io
import re
import shlex
from pathlib import Path

import pytest
from rich.console import Console

from dftc_rt.analysis import summary
from dftc_rt.analysis.metrics import evaluate
from dftc_rt.cli.main import build
from dftc_rt.cli.session import open_session
from dftc_rt.cli.simulate import run_simulation

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "gallery.md").read_text()
BLOCKS = re.findall(r"^```(sh|text)\n(.*?)\n```$", PAGE, re.MULTILINE | re.DOTALL)
COMMANDS = [shlex.split(line)[1:] for kind, text in BLOCKS if kind == "sh"
            for line in text.splitlines()]  # fmt: skip
SIMULATIONS = [command for command in COMMANDS if command[0] == "simulate"]
PRINTED = [text for kind, text in BLOCKS if kind == "text"]


def test_every_picture_is_there_and_made_by_a_command_of_the_page() -> None:
    made = [command[command.index("-o") + 1] for command in COMMANDS if command[0] == "report"]
    shown = [f"docs/{name}" for name in re.findall(r"!\[.*?\]\((.*?)\)", PAGE)]
    assert made == shown
    there = {path.relative_to(ROOT).as_posix() for path in (ROOT / "docs/images/gallery").iterdir()}
    assert set(made) == there
    for name in made:
        assert (ROOT / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_is_understood(command: list[str]) -> None:
    function, bound, _ = build().parse_args(command, exit_on_error=False, print_error=False)
    assert function.__name__ == command[0]
    assert bound.arguments


@pytest.mark.slow
@pytest.mark.parametrize(("command", "text"), list(zip(SIMULATIONS, PRINTED, strict=True)))
def test_the_numbers_are_those_of_the_run(command: list[str], text: str) -> None:
    settings = [command[i + 1] for i, word in enumerate(command) if word == "--set"]
    run, _ = run_simulation(open_session(command[1], settings), progress=False)
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(summary.table(evaluate(run)))
    printed = "\n".join(line.rstrip() for line in console.export_text().splitlines())
    assert printed.startswith(text)
