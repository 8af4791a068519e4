"""``dftc doctor``: what this machine lacks for real time and CAN."""

from __future__ import annotations

import dataclasses
import sys

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from dftc_rt.errors import EnvironmentLacksError
from dftc_rt.rt.doctor import Check, examine


def doctor(*, json: bool = False) -> int:
    """Say what this machine lacks for real time and CAN, and how to get it.

    Exit code 0 when nothing essential is missing, else 3.

    For example: dftc doctor --json

    Args:
        json: Print one JSON object.
    """
    checks = examine()
    lacking = [check.name for check in checks if check.essential and not check.ok]
    if json:
        found = {"ok": not lacking, "checks": [dataclasses.asdict(check) for check in checks]}
        sys.stdout.write(msgspec.json.encode(found).decode() + "\n")
    else:
        console = Console()
        console.print(table(checks))
        if not lacking:
            console.print(
                "Nothing essential is missing; what is missing costs precision or a feature."
            )
    return EnvironmentLacksError.exit_code if lacking else 0


def table(checks: list[Check]) -> Table:
    """Return the findings as a table, with meaning and remedy where something is missing."""
    result = Table(show_edge=False, pad_edge=False)
    result.add_column("")
    result.add_column("what", no_wrap=True)
    result.add_column("found, and what to do")
    for check in checks:
        mark, style = ("ok", "green") if check.ok else ("missing", "yellow")
        if check.essential and not check.ok:
            mark, style = "MISSING", "bold red"
        text = Text(check.found)
        if not check.ok:
            text.append(f"\n{check.means}\n", style="dim")
            text.append(check.remedy)
        result.add_row(Text(mark, style=style), check.name, text)
    return result
