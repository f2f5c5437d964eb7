"""Who watches whom in a camera experiment, and the camera controller that is tried on them."""

from __future__ import annotations

import math

from deltaq_cell.cell_model import CellModel
from deltaq_cell.roles import camera_roles
from deltaq_controllers.camera.aim import TOOL
from deltaq_controllers.camera.controllers import FocusController, camera_controller_named
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.surroundings.setpoints import lag_s
from deltaq_experiments.options import Options
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError

VIEW_DISTANCE_M = 1.25

LOOP_CYCLES = 3
"""Cycles from a measurement to the drives: the answer, its transport to the controller, the drives' sampling."""


def load(options: Options) -> Scene:
    """The cell of an experiment, and who watches whom in it.

    Raises:
        DeltaqError: there is no such cell, or its robots cannot be what they are to be.
    """
    return scene_of(CellModel.load(options.cell), options)


def scene_of(cell: CellModel, options: Options | None = None) -> Scene:
    """Who watches whom in a cell, by its description unless the options name them.

    Args:
        cell: the cell.
        options: with the robots that were named, and the point that is looked at; None for the cell's own.

    Raises:
        RoleError: a robot cannot be what it is to be.
    """
    options = options or Options()
    roles = camera_roles(cell.description, options.robot, options.leader)
    return Scene(cell, roles.follower, roles.leader, options.aim_offset_m)


def camera_controller(
    scene: Scene, name: str = "paper", distance_m: float = VIEW_DISTANCE_M, focus: Array | None = None
) -> FocusController:
    """The camera controller of that name, looking at a point of the leader's tool or at a fixed point.

    Raises:
        DeltaqError: if there is none of that name.
    """
    return camera_controller_named(name, scene, distance_m, focus)


def aim_arguments(options: Options) -> list[str]:
    """Arguments of `deltaq_controllers.camera_follower` that say what is looked at."""
    if options.aim_offset_m == TOOL:
        return []
    return ["--aim-offset-m", *(f"{part:g}" for part in options.aim_offset_m)]


def loop_latency_s(scene: Scene) -> float:
    """Time from the leader's motion to the camera's without a delay of the link: drives and cycles [s]."""
    return LOOP_CYCLES * scene.cycle_s + lag_s(scene.robot.description.servo_lag)


def link_cycles(scene: Scene, latency_s: float) -> int:
    """Cycles by which a link that delays by `latency_s` holds the leader's states back.

    Raises:
        DeltaqError: the latency is no finite time of at least 0 s.
    """
    if not 0.0 <= latency_s < math.inf:
        raise DeltaqError(f"latency_s must be a finite time of at least 0 s, got {latency_s}")
    return round(latency_s / scene.cycle_s)
