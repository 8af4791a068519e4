"""Layouts with which Foxglove and PlotJuggler show a log of this project, for any robot.

Field names carry joint names, so a layout is of one robot. Both formats are what the
programs export themselves; neither has a published schema.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Final
from xml.etree import ElementTree

from dftc_rt.log.schema import field_name

GROUPS: Final = (
    ("effectiveness", (("/cycle", "rho_hat"), ("/rig", "rho"))),
    ("position, measured and desired / rad", (("/cycle", "q"), ("/cycle", "qd"))),
    ("torque, sent and applied / Nm", (("/cycle", "tau_cmd"), ("/rig", "tau_applied"))),
    ("residual / Nm", (("/cycle", "residual"),)),
    ("verdict", (("/cycle", "verdict"),)),
)
"""Title, and topic and row of each curve that every joint has."""

TIMING: Final = ("lateness", "compute", "exchange")
_COLOURS: Final = (
    "#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2",
)  # fmt: skip


def foxglove_layout(joints: Sequence[str]) -> str:
    """Return a layout for Foxglove and Lichtblick: the robot in 3D, its plots, events.

    Args:
        joints: Joint names, in order.

    Returns:
        JSON, to be imported with "Layouts > Import from file".
    """
    robot = {
        "cameraState": {"distance": 3, "phi": 60, "thetaOffset": 45, "target": [0, 0, 0]},
        "followMode": "follow-none",
        "scene": {"meshUpAxis": "z_up"},
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid",
                "visible": True, "size": 4, "divisions": 8,
            },
            "urdf": {
                "layerId": "foxglove.Urdf", "instanceId": "urdf", "label": "Robot",
                "visible": True, "sourceType": "topic", "topic": "/robot_description",
                "url": "", "filePath": "", "parameter": "", "framePrefix": "",
                "displayMode": "auto",
            },
        },
        "topics": {},
    }  # fmt: skip
    panels: dict[str, Any] = {
        "3D!robot": robot,
        "RawMessages!events": {"topicPath": "/events", "diffEnabled": False},
        "StateTransitions!verdicts": {
            "paths": [
                {"value": f"/cycle.verdict_{field_name(joint)}", "label": joint,
                 "timestampMethod": "receiveTime"}
                for joint in joints
            ],
            "isSynced": True,
        },
        "Plot!timing": _plot("timing / s", [("/cycle", name, name) for name in TIMING]),
    }  # fmt: skip
    for title, curves in GROUPS[:-1]:  # verdicts have the state transitions
        panels[f"Plot!{title.split(',')[0].split()[0]}"] = _plot(
            title,
            [
                (topic, f"{row}_{field_name(joint)}", f"{row} {joint}")
                for joint in joints
                for topic, row in curves
            ],
        )
    left = _split("column", ["3D!robot", "StateTransitions!verdicts", "RawMessages!events"])
    right = _split("column", [name for name in panels if name.startswith("Plot!")])
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"first": left, "second": right, "direction": "row", "splitPercentage": 40},
    }
    return json.dumps(layout, indent=1) + "\n"


def _plot(title: str, curves: Sequence[tuple[str, str, str]]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": [
            {"value": f"{topic}.{field}", "label": label, "enabled": True,
             "timestampMethod": "receiveTime", "color": _COLOURS[at % len(_COLOURS)]}
            for at, (topic, field, label) in enumerate(curves)
        ],
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "left",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
    }  # fmt: skip


def _split(direction: str, names: Sequence[str]) -> Any:
    """Return panels side by side, all of the same size."""
    if len(names) == 1:
        return names[0]
    return {
        "first": names[0],
        "second": _split(direction, names[1:]),
        "direction": direction,
        "splitPercentage": 100 / len(names),
    }


def plotjuggler_layout(joints: Sequence[str]) -> str:
    """Return a layout for PlotJuggler 3: a tab per quantity, a plot per joint.

    Args:
        joints: Joint names, in order.

    Returns:
        XML, to be opened with "Layout > Load" after the log, or ``plotjuggler -d LOG -l FILE``.
    """
    root = ElementTree.Element("root")
    window = ElementTree.SubElement(
        root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"}
    )
    for title, curves in GROUPS:
        _tab(
            window,
            title,
            [[f"{topic}/{row}_{field_name(joint)}" for topic, row in curves] for joint in joints],
        )
    _tab(window, "timing / s", [[f"/cycle/{name}"] for name in TIMING])
    ElementTree.SubElement(window, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.indent(root, " ")
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _tab(window: ElementTree.Element, title: str, plots: Sequence[Sequence[str]]) -> None:
    tab = ElementTree.SubElement(window, "Tab", tab_name=title, containers="1")
    splitter = ElementTree.SubElement(
        ElementTree.SubElement(tab, "Container"),
        "DockSplitter",
        orientation="-",
        count=str(len(plots)),
        sizes=";".join([f"{1 / len(plots):.6f}"] * len(plots)),
    )
    for curves in plots:
        area = ElementTree.SubElement(splitter, "DockArea", name="...")
        plot = ElementTree.SubElement(
            area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false"
        )
        ElementTree.SubElement(plot, "limitY")
        for at, curve in enumerate(curves):
            ElementTree.SubElement(plot, "curve", name=curve, color=_COLOURS[at])
