"""An import-linter contract that lists what is allowed, and so refuses the rest.

import-linter's own contracts list what is forbidden, which a new folder slips
through. Here a module that no arrow names is itself a violation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output


@dataclass(frozen=True)
class Violation:
    """One import, or one module, that the table does not know.

    Attributes:
        importer: Importing module.
        imported: Imported module ("" when the importer itself is in no row).
        reason: What the table allows instead.
    """

    importer: str
    imported: str
    reason: str


def parse(rows: list[str], sign: str) -> dict[str, tuple[str, ...]]:
    """Return ``{left: (right, ...)}`` from rows such as ``"a -> b c"``.

    Raises:
        ValueError: A row has no ``sign``, or its left side stands twice.
    """
    table: dict[str, tuple[str, ...]] = {}
    for row in rows:
        left, found, right = (part.strip() for part in row.partition(sign))
        if not found or not left or left in table:
            raise ValueError(f"bad or repeated row {row!r}, expected 'left {sign} right …'")
        table[left] = tuple(right.split())
    return table


def within(module: str, place: str) -> bool:
    """Return whether ``module`` is ``place`` or lies below it."""
    return module == place or module.startswith(place + ".")


def violations(
    graph: ImportGraph,
    arrows: dict[str, tuple[str, ...]],
    importers: dict[str, tuple[str, ...]],
) -> list[Violation]:
    """Return every import of ``graph`` that no row allows, sorted.

    Args:
        graph: Import graph, external packages included.
        arrows: For each place, the places it may import.
        importers: For each external package, the places that may import it.
    """
    roots = {place.partition(".")[0] for place in arrows}
    found = []
    for module in graph.modules:
        if module.partition(".")[0] not in roots:
            continue
        place = max((p for p in arrows if within(module, p)), key=len, default="")
        if not place and module not in roots:
            found.append(Violation(module, "", "it is in no row of the table"))
            continue
        allowed = arrows.get(place, ())
        for imported in graph.find_modules_directly_imported_by(module):
            package = imported.partition(".")[0]
            if package in roots:
                inside = bool(place) and within(imported, place)
                if not inside and not any(within(imported, a) for a in allowed):
                    reason = f"{place or module} may import: {' '.join(allowed) or 'nothing'}"
                    found.append(Violation(module, imported, reason))
            elif package in importers and not any(within(module, a) for a in importers[package]):
                reason = f"{package} may be imported by: {' '.join(importers[package])}"
                found.append(Violation(module, imported, reason))
    return sorted(found, key=lambda v: (v.importer, v.imported))


class AllowListContract(Contract):
    """``arrows``: ``"place -> allowed places"``; ``importers``: ``"package <- places"``."""

    # Fields on the class, lists of their values on an instance.
    arrows: Any = fields.ListField(subfield=fields.StringField())
    importers: Any = fields.ListField(subfield=fields.StringField())

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        found = violations(graph, parse(self.arrows, "->"), parse(self.importers, "<-"))
        return ContractCheck(kept=not found, metadata={"violations": found})

    def render_broken_contract(self, check: ContractCheck) -> None:
        for v in check.metadata["violations"]:
            what = f"imports {v.imported}: " if v.imported else ""
            output.print_error(f"{v.importer} {what}{v.reason}")
