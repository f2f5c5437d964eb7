"""Experiments take from the cell who watches whom: names mean nothing, and each camera has its turn."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from deltaq_cell.cell_model import CellModel
from deltaq_cell.find import find_cell
from deltaq_cell.roles import RoleError
from deltaq_experiments import collision, tracking
from deltaq_experiments.options import Options
from deltaq_experiments.report import ExperimentOutcome
from deltaq_experiments.scene import load
from deltaq_protocol.arrays import Array

TURNED_DEG = -60.0
"""To the east, where there is room."""
RENAMED = {"fr": "watcher", "gr": "worker"}


def renamed(folder: Path) -> Path:
    """The lab cell, its robots by other names."""
    text = find_cell("lab").read_text(encoding="utf-8")
    for name, other in RENAMED.items():
        text, count = re.subn(rf"^  {name}:$", f"  {other}:", text, flags=re.MULTILINE)
        assert count == 1
        text = text.replace(f"{name}/", f"{other}/")
    file = folder / "renamed.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def figures(outcome: ExperimentOutcome) -> dict[str, Any]:
    """All that a report tells but how long it took, the robots by their names in the lab."""
    text = outcome.report.model_dump_json(exclude={"real_time_factor"})
    for name, other in RENAMED.items():
        text = text.replace(other, name)
    told: dict[str, Any] = json.loads(text)
    return told


def curves(outcome: ExperimentOutcome) -> list[Array]:
    return [line.values for panel in outcome.panels for line in panel.lines]


TRACKING = Options(controller="qp", duration_s=0.6, settle_s=0.0, leader_speed_m_s=0.5)
ATTACK = Options(controller="qp", duration_s=0.6, settle_s=0.0, leader_speed_m_s=0.5)
UNGATED = Options(controller="escape", duration_s=0.6, settle_s=0.0, gated=False)


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize(
    ("run", "options"),
    [(tracking.run, TRACKING), (collision.run, ATTACK), (collision.run, UNGATED)],
    ids=["tracking", "attack", "attack without a gate"],
)
def test_renamed_robots_give_bit_identical_figures(
    run: Callable[[Options], ExperimentOutcome], options: Options, tmp_path: Path
) -> None:
    lab, other = run(options), run(replace(options, cell=renamed(tmp_path)))
    assert (other.report.robot, other.report.leader) == ("watcher", "worker")
    assert figures(other) == figures(lab)
    for one, another in zip(curves(lab), curves(other), strict=True):
        np.testing.assert_array_equal(one, another)


def with_a_second_camera(folder: Path) -> Path:
    """The lab cell with another robot like `fr`, turned by 60 degrees about the leader's tool."""
    lab = CellModel.load("lab")
    fr, gr = lab.description.robots["fr"], lab.robots["gr"]
    tool, base = gr.forward(gr.home)[:2, 3], np.array(fr.base.position_m)
    turn = np.deg2rad(TURNED_DEG)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    like = fr.model_dump(mode="json", exclude_unset=True)
    second = like | {
        "server": "tcp/127.0.0.1:7453",
        "driver": like["driver"] | {"port": 49154, "control_port": 49254},
        "mounted_on": ["floor"],
        "base": {
            "position_m": [*(tool + R @ (base[:2] - tool)).tolist(), float(base[2])],
            "rpy_deg": [0.0, 0.0, fr.base.rpy_deg[2] + TURNED_DEG],
        },
    }
    file = folder / "two-cameras.yaml"
    file.write_text(
        yaml.safe_dump({"extends": "lab", "cell": "two-cameras", "robots": {"second": second}}),
        encoding="utf-8",
    )
    return file


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("camera", ["fr", "second"])
def test_in_a_cell_of_three_robots_each_camera_tracks_the_robot_without_one(
    camera: str, tmp_path: Path
) -> None:
    options = replace(TRACKING, cell=with_a_second_camera(tmp_path), robot=camera)
    report = tracking.run(options).report
    assert (report.robot, report.leader) == (camera, "gr")
    assert report.angle_deg.final < 0.9
    assert report.leader_reached_m_s.mean > 0.2
    assert report.gate.admitted > 90, "both of those that move"
    assert report.gate.held + report.gate.refused == 0
    assert sum(report.limits.model_dump().values()) == 0
    assert report.clearance_m.min > 0.05


def test_only_a_robot_with_a_camera_watches_and_it_can_be_watched_too(tmp_path: Path) -> None:
    with pytest.raises(RoleError, match="robot 'gr' has no camera to follow with; fr has one"):
        load(Options(robot="gr"))
    scene = load(Options(cell=with_a_second_camera(tmp_path), robot="second", leader="fr"))
    assert (scene.robot.name, scene.leader.name) == ("second", "fr")


@pytest.mark.nightly
def test_a_camera_on_the_gantry_tracks_the_robot_on_the_floor(tmp_path: Path) -> None:
    camera = {"pose": {"position_m": [0.0, 0.0, 0.3]}, "vertical_view_deg": 45, "baseline_m": 0.12}
    file = tmp_path / "swapped.yaml"
    swapped = {"extends": "lab", "cell": "swapped", "robots": {"gr": {"camera": camera}}}
    file.write_text(yaml.safe_dump(swapped), encoding="utf-8")
    options = replace(TRACKING, cell=file, robot="gr", leader="fr", duration_s=4.0, settle_s=3.0)
    report = tracking.run(options).report
    assert (report.robot, report.leader) == ("gr", "fr")
    assert report.angle_deg.max < 0.1
    assert report.distance_m.max < 0.003
    assert report.seen.by_all_eyes == 1.0
    assert report.gate.held + report.gate.refused == 0
