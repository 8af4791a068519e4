"""Layouts for viewers name fields that a log has, and the shipped ones are up to date."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from dftc_rt.analysis.viewer_layouts import foxglove_layout, plotjuggler_layout
from dftc_rt.control import signals
from dftc_rt.dynamics.robot import load_robot
from dftc_rt.log.schema import cycle_layout, rig_layout

ROOT = Path(__file__).parents[3]
JOINTS = ("shoulder", "LF-HAA")  # the second has a character that no field has


def fields(joints: tuple[str, ...]) -> set[tuple[str, str]]:
    layouts = (cycle_layout(joints, signals.NAMES), rig_layout(joints))
    return {(layout.topic, field) for layout in layouts for field in layout.fields}


def panels_of(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        yield from panels_of(layout["first"])
        yield from panels_of(layout["second"])


def test_foxglove_shows_fields_of_the_log_and_every_panel_once() -> None:
    layout = json.loads(foxglove_layout(JOINTS))
    panels = layout["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    named = {tuple(path.split(".", 1)) for path in paths}
    assert named <= fields(JOINTS)
    assert {("/cycle", "rho_hat_LF_HAA"), ("/rig", "rho_LF_HAA")} <= named
    assert sorted(panels_of(layout["layout"])) == sorted(panels)
    assert panels["3D!robot"]["layers"]["urdf"]["topic"] == "/robot_description"


def test_plotjuggler_shows_fields_of_the_log_a_plot_for_each_joint() -> None:
    root = ElementTree.fromstring(plotjuggler_layout(JOINTS))
    names = [curve.attrib["name"] for curve in root.iter("curve")]
    named = {("/" + name.split("/")[1], name.split("/")[2]) for name in names}
    assert named <= fields(JOINTS)
    for tab in root.iter("Tab"):
        splitter = next(tab.iter("DockSplitter"))
        plots = list(tab.iter("plot"))
        assert splitter.attrib["count"] == str(len(plots))
        assert len(plots) == (3 if tab.attrib["tab_name"].startswith("timing") else len(JOINTS))


@pytest.mark.parametrize(
    ("file", "make"),
    [("panda.foxglove.json", foxglove_layout), ("panda.plotjuggler.xml", plotjuggler_layout)],
)
def test_shipped_layouts_are_what_the_code_makes(
    file: str, make: Callable[[tuple[str, ...]], str]
) -> None:
    assert (ROOT / "docs" / "viewers" / file).read_text() == make(load_robot("panda").joints)
