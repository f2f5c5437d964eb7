"""The roles of the robots in a camera experiment, and its camera controller."""

import math
from typing import Protocol

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.roles import camera_roles
from deltaq_controllers.camera import FOLLOWS
from deltaq_controllers.camera.controllers import FocusController, camera_controller_named
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.surroundings.setpoints import lag_s
from deltaq_experiments.options import Options
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages.motion import AIM_M
from deltaq_testing.oracle import ClearanceOracle

VIEW_DISTANCE_M = 1.25

LOOP_CYCLES = 3
"""Cycles from a measurement to the drives: the answer, its transport to the controller, the drives' sampling."""


def load(options: Options) -> Scene:
    """The cell of an experiment, and the roles of its robots.

    Raises:
        DeltaqError: there is no such cell, or its robots cannot take these roles.
    """
    return scene_of(CellModel.load(options.cell), options)


def scene_of(cell: CellModel, options: Options | None = None) -> Scene:
    """The roles of a cell's robots, from the options or else from its description.

    Args:
        cell: the cell.
        options: with the named robots and the watched point; None for the cell's own.

    Raises:
        RoleError: a robot cannot take its role.
    """
    options = options or Options()
    roles = camera_roles(cell.description, options.robot, options.leader)
    return Scene(cell, roles.follower, roles.leader, options.aim_offset_m)


def camera_controller(
    scene: Scene, name: str = FOLLOWS, distance_m: float = VIEW_DISTANCE_M, focus: Array | None = None
) -> FocusController:
    """The camera controller of that name, looking at a point of the leader's tool or at a fixed point.

    Raises:
        DeltaqError: if the name is unknown.
    """
    return camera_controller_named(name, scene, distance_m, focus)


def aim_arguments(options: Options) -> list[str]:
    """Arguments of `deltaq_controllers.camera_follower` for the target."""
    if options.aim_offset_m == AIM_M:
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


LEAST_CLEARANCE_M = 0.15
LEAST_SELF_CLEARANCE_M = 0.05
DISTANCES_M = 0.9, 1.7
"""View distances that a start may have."""

_REACH_RAD = np.array([0.6, 0.4, 0.4, 3.0, 2.0, 1.5])
"""Ranges around home from which the joints of a start are drawn; the wrist's are largest."""


class MeasuredView(Protocol):
    """What measures a view.

    Attributes:
        desired_distance_m: desired view distance [m].
    """

    desired_distance_m: float

    def errors(self, q: Array, q_leader: Array) -> tuple[float, float]:
        """View angle error [rad] and view distance less the desired one [m]."""
        ...


def start_with_error(scene: Scene, camera: MeasuredView, error: float, seed: int) -> Array:
    """A configuration from which the camera misses the leader's tool at its home by a given angle.

    Args:
        scene: the roles of the robots.
        camera: measures the view.
        error: the angle [rad].
        seed: of the search.

    Returns:
        (n,) configuration of the robot with the camera, clear of everything [rad].

    Raises:
        DeltaqError: if none is found.
    """
    robot, q_leader = scene.robot, scene.leader.home
    at_home = {name: one.home for name, one in scene.cell.robots.items()}
    random, oracle = np.random.default_rng(seed), ClearanceOracle(scene.cell)
    guard = 0.05 * (robot.upper - robot.lower)
    reach = np.resize(_REACH_RAD, robot.n)
    for _ in range(2000):
        far = np.clip(robot.home + random.uniform(-reach, reach), robot.lower + guard, robot.upper - guard)
        if camera.errors(far, q_leader)[0] < error:
            continue
        q = _between(camera, robot.home, far, q_leader, error)
        distance = camera.errors(q, q_leader)[1] + camera.desired_distance_m
        if not DISTANCES_M[0] < distance < DISTANCES_M[1]:
            continue
        places = at_home | {robot.name: q}
        if (
            oracle.between_robots_and_structure(places).distance_m > 0.9 * LEAST_CLEARANCE_M
            and oracle.between_robots(places).distance_m > LEAST_CLEARANCE_M
            and oracle.of_one_robot(places).distance_m > LEAST_SELF_CLEARANCE_M
        ):
            return q
    raise DeltaqError(
        f"no configuration of {robot.name} looks {np.rad2deg(error):.0f} degrees past the leader's tool within its "
        "limits and clear of everything; try another --seed"
    )


def _between(camera: MeasuredView, near: Array, far: Array, q_leader: Array, error: float) -> Array:
    """The configuration between `near` and `far` at which the angle passes `error`."""
    low, high = 0.0, 1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        if camera.errors(near + middle * (far - near), q_leader)[0] < error:
            low = middle
        else:
            high = middle
    return near + high * (far - near)
