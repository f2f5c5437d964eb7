"""Writes `deploy/foxglove/lab.json`, a layout that shows a recording in Foxglove: `python -m deltaq_deploy.foxglove`.

With the name or the file of a cell it prints that cell's instead.

Field paths follow from the table of topics and the messages; a test resolves each in a recording. Foxglove's format of
layouts is not documented: this follows layouts that it exports.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import topics
from deltaq_protocol.topic import Topic
from deltaq_services.recorder.frames import WORLD
from deltaq_services.recorder.writer import TRANSFORMS

FILE = Path(__file__).parents[1] / "foxglove" / "lab.json"
CELL = "lab"


def layout(cell: CellModel) -> dict[str, Any]:
    """The layout for recordings of a cell, as Foxglove imports it."""
    robots = cell.description_message().robots
    name = cell.description.cell
    panels = {
        "3D!cell": _view(),
        "StateTransitions!gate": {
            "paths": [
                _path(_field(name, topic, robot, field), f"{robot} {label}")
                for robot in robots
                for topic, field, label in (
                    (topics.STATE, "phase", "phase"),
                    (topics.VERDICT, "outcome", "verdict"),
                    (topics.VERDICT, "reasons[0].code", "reason"),
                )
            ],
            "isSynced": True,
        },
        "Plot!clearance": _plot(
            "Clearance [m]",
            [
                *(
                    (_field(name, topics.VERDICT, robot, "clearance_m"), f"{robot}, verdict")
                    for robot in robots
                ),
                (_field(name, topics.PROXIMITY, "", "pairs[0].distance_m"), "nearest pair"),
            ],
        ),
        "Plot!scale": _plot(
            "Share of the request that was admitted",
            [(_field(name, topics.VERDICT, robot, "scale"), robot) for robot in robots],
        ),
    }
    for robot, summary in robots.items():
        for unit, title in (("rad", "joints [rad]"), ("m", "linear axes [m]")):
            paths = [
                (_field(name, topics.STATE, robot, f"q[{index}]"), joint)
                for index, joint in enumerate(summary.joints)
                if summary.units[index] == unit
            ]
            if paths:
                panels[f"Plot!{robot}_{unit}"] = _plot(f"{robot}, {title}", paths)
    left, right = (
        ["3D!cell", "StateTransitions!gate"],
        [panel for panel in panels if panel.startswith("Plot!")],
    )
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": _stacked(left, first_percent=60),
            "second": _stacked(right),
            "splitPercentage": 50,
        },
    }


def _field(cell: str, topic: Topic, robot: str, field: str) -> str:
    return f"{topic.key(cell, robot=robot)}.{field}"


def _path(value: str, label: str) -> dict[str, Any]:
    return {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime"}


def _plot(title: str, paths: list[tuple[str, str]]) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "paths": [_path(value, label) for value, label in paths],
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
    }


def _view() -> dict[str, Any]:
    """The frames of the links, in the world; a recording has the URDFs as attachments, not as a topic."""
    return {
        "cameraState": {
            "perspective": True,
            "distance": 9.0,
            "phi": 65.0,
            "thetaOffset": 60.0,
            "target": [0.0, 0.0, 0.0],
            "targetOffset": [0.0, 0.0, 1.0],
            "targetOrientation": [0.0, 0.0, 0.0, 1.0],
            "fovy": 45.0,
            "near": 0.05,
            "far": 100.0,
        },
        "followMode": "follow-none",
        "followTf": WORLD,
        "scene": {"transforms": {"axisScale": 0.3, "showLabel": False}},
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid",
                "visible": True,
                "frameId": WORLD,
                "size": 10,
                "divisions": 10,
            }
        },
        "topics": {TRANSFORMS: {"visible": True}},
    }


def _stacked(panels: list[str], first_percent: float | None = None) -> Any:
    """Panels one above the other, of equal heights unless the first one's is given."""
    first, *rest = panels
    if not rest:
        return first
    return {
        "direction": "column",
        "first": first,
        "second": _stacked(rest),
        "splitPercentage": first_percent or 100.0 / len(panels),
    }


def layout_text(cell: str) -> str:
    """The layout of a cell as the text of a file."""
    return json.dumps(layout(CellModel.load(cell)), indent=1) + "\n"


def main() -> None:
    """Write the committed layout, or print that of the cell named."""
    if arguments := sys.argv[1:]:
        print(layout_text(arguments[0]), end="")
    else:
        FILE.write_text(layout_text(CELL), encoding="utf-8")


if __name__ == "__main__":
    main()
