"""``dftc bus``: virtual buses, and what travels on the buses of a robot."""

from __future__ import annotations

from cyclopts import App

from dftc_rt.cli import bus_budget, bus_dbc, bus_links


def bus() -> App:
    """Return the group of commands."""
    group = App(
        name="bus",
        help=(
            "Virtual buses, and what travels on a robot's buses.\n\n"
            "Example::\n\n    dftc bus budget panda_shoulder_loss"
        ),
    )
    for function in (bus_links.up, bus_links.down, bus_budget.budget, bus_dbc.dbc):
        group.command(function)
    return group
