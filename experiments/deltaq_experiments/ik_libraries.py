"""Public libraries of inverse kinematics on the drives of `directions`: `python -m deltaq_experiments.ik_libraries`.

pink and mink solve one quadratic programme a cycle, as the hands' modes do, with tasks that are weighed against one
another. They are no dependency: install `pin-pink mink daqp` beside deltaq, in an environment of its own. Each hand
has a task of cost 1 per m and 0.5 per rad, the robot a posture task of 1e-3; the limits are those of position and
speed, neither knows any of acceleration. Both solve by DAQP, as ours does.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import version
from types import ModuleType
from typing import Any, Protocol
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError
from deltaq_controllers.live import model_of
from deltaq_controllers.modes.motion import HAND_AXES
from deltaq_experiments.directions import WHOLE, DirectionGone, commands, judged
from deltaq_launch.program import run_program
from deltaq_protocol.arrays import Array

POSITION_COST, ORIENTATION_COST, POSTURE_COST = 1.0, 0.5, 1e-3
SOLVER = "daqp"


class Follower(Protocol):
    """Moves a robot's hands to poses, cycle by cycle."""

    def step(self, poses: Sequence[Array]) -> Array:
        """The next configuration (n,), each hand nearer to its pose `T_world_hand` (4, 4)."""
        ...


class Pink:
    """pink's loop.

    Args:
        robot: that begins at its home.
        cycle_s: its cycle [s].

    Raises:
        ControllerError: pink is not installed.
    """

    def __init__(self, robot: RobotModel, cycle_s: float) -> None:
        self._pink, tasks = imported("pink"), imported("pink.tasks")
        model = robot.model.copy()
        model.lowerPositionLimit, model.upperPositionLimit = robot.lower, robot.upper
        model.velocityLimit = robot.max_velocity
        self._configuration = self._pink.Configuration(model, model.createData(), robot.home.copy())
        names = [model.frames[robot.frame_of(hand)].name for hand in robot.hands]
        self._hands = [tasks.FrameTask(name, POSITION_COST, ORIENTATION_COST) for name in names]
        self._posture = tasks.PostureTask(cost=POSTURE_COST)
        self._posture.set_target(robot.home)
        self._cycle_s = cycle_s

    def step(self, poses: Sequence[Array]) -> Array:
        """The next configuration."""
        for task, pose in zip(self._hands, poses, strict=True):
            task.set_target(pin.SE3(pose))
        tasks = [*self._hands, self._posture]
        velocity = self._pink.solve_ik(
            self._configuration, tasks, self._cycle_s, solver=SOLVER, safety_break=False
        )
        self._configuration.integrate_inplace(velocity, self._cycle_s)
        q: Array = np.array(self._configuration.q)
        return q


class Mink:
    """mink's loop, on a MuJoCo model with the robot's joints and nothing else.

    Args:
        robot: that begins at its home.
        cycle_s: its cycle [s].

    Raises:
        ControllerError: mink is not installed.
    """

    def __init__(self, robot: RobotModel, cycle_s: float) -> None:
        self._mink = mink = imported("mink")
        model = imported("mujoco").MjModel.from_xml_string(mjcf(robot))
        self._configuration = mink.Configuration(model, robot.home.copy())
        self._hands = [mink.FrameTask(hand, "site", POSITION_COST, ORIENTATION_COST) for hand in robot.hands]
        self._posture = mink.PostureTask(model, POSTURE_COST)
        self._posture.set_target(robot.home)
        speeds = dict(zip(robot.joint_names, robot.max_velocity.tolist(), strict=True))
        self._limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]
        self._cycle_s = cycle_s

    def step(self, poses: Sequence[Array]) -> Array:
        """The next configuration."""
        for task, pose in zip(self._hands, poses, strict=True):
            task.set_target(self._mink.SE3.from_matrix(pose))
        tasks = [*self._hands, self._posture]
        velocity = self._mink.solve_ik(self._configuration, tasks, self._cycle_s, SOLVER, limits=self._limits)
        self._configuration.integrate_inplace(velocity, self._cycle_s)
        q: Array = np.array(self._configuration.q)
        return q


LIBRARIES: dict[str, tuple[str, Callable[[RobotModel, float], Follower]]] = {
    "pink": ("pin-pink", Pink),
    "mink": ("mink", Mink),
}
"""Each with the package that it comes in."""


def imported(module: str) -> ModuleType:
    """A module of a library.

    Raises:
        ControllerError: it is not installed; says what to do.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ControllerError(
            f"{module} cannot be imported ({error}): in an environment of its own, pip install pin-pink mink daqp "
            "beside deltaq; it is no dependency"
        ) from None


def mjcf(robot: RobotModel) -> str:
    """The robot's joints as MuJoCo reads them: each body with one joint, and a site for each hand."""
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "compiler", angle="radian")
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, robot.home)
    bodies = {0: ElementTree.SubElement(root, "worldbody")}
    for joint in range(1, model.njoints):
        place = model.jointPlacements[joint]
        parent, name = bodies[model.parents[joint]], model.names[joint]
        bodies[joint] = body = ElementTree.SubElement(
            parent, "body", {"name": f"{name}_body", **_placed(place)}
        )
        ElementTree.SubElement(body, "inertial", pos="0 0 0", mass="1", diaginertia="1 1 1")
        column = model.joints[joint].idx_v
        axis = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, column]
        turns = bool(robot.revolute[column])
        moved = {"type": "hinge" if turns else "slide", "axis": _numbers(axis[3:] if turns else axis[:3])}
        limits = _numbers(np.array([robot.lower[column], robot.upper[column]]))
        ElementTree.SubElement(body, "joint", {"name": name, "limited": "true", "range": limits, **moved})
    for hand in robot.hands:
        frame = model.frames[robot.frame_of(hand)]
        ElementTree.SubElement(bodies[frame.parentJoint], "site", {"name": hand, **_placed(frame.placement)})
    return ElementTree.tostring(root, encoding="unicode")


def _placed(place: Any) -> dict[str, str]:
    x, y, z, w = pin.Quaternion(place.rotation).coeffs().tolist()
    return {"pos": _numbers(place.translation), "quat": _numbers(np.array([w, x, y, z]))}


def _numbers(values: Array) -> str:
    return " ".join(repr(value) for value in values.tolist())


def followed(
    robot: RobotModel, follower: Follower, rates: dict[str, float], duration_s: float, cycle_s: float
) -> tuple[list[Array], list[float]]:
    """Lead the hands along one axis from home: configurations (n,), and processor time of each step [s]."""
    ((axis, rate),) = rates.items()
    hand, _, plain = axis.rpartition(".")
    start = [robot.forward(robot.home, name) for name in robot.hands]
    twist = rate * np.eye(6)[HAND_AXES.index(plain)]
    way, seconds = [robot.home.copy()], []
    for cycle in range(1, round(duration_s / cycle_s) + 1):
        poses = [pose.copy() for pose in start]
        for name, pose in zip(robot.hands, poses, strict=True):
            if hand in ("", name):
                pose[:3, 3] += twist[:3] * cycle * cycle_s
                pose[:3, :3] = pin.exp3(twist[3:] * cycle * cycle_s) @ pose[:3, :3]
        begin = time.thread_time()
        way.append(follower.step(poses))
        seconds.append(time.thread_time() - begin)
    return way, seconds


def run(library: str, cell: str, robot: str, duration_s: float = 6.0) -> dict[str, Any]:
    """Drive every direction with one library.

    Raises:
        ControllerError: there is no such library or robot, or it is not installed.
    """
    if library not in LIBRARIES:
        raise ControllerError(f"no library {library!r}; there are {', '.join(LIBRARIES)}")
    imported(library)
    package, make = LIBRARIES[library]
    loaded = CellModel.load(cell)
    model, cycle_s = model_of(loaded.robots, robot), loaded.description.cycle_s
    directions: list[DirectionGone] = []
    seconds: list[float] = []
    for rates in commands(model):
        way, taken = followed(model, make(model, cycle_s), rates, duration_s, cycle_s)
        directions.append(judged(model, rates, way, duration_s))
        seconds += taken
    p50, p99 = (round(1000.0 * float(np.percentile(seconds, p)), 4) for p in (50, 99))
    return {
        "library": library,
        "version": version(package),
        "robot": robot,
        "whole": sum(one.share >= WHOLE for one in directions),
        "directions": [asdict(one) for one in directions],
        "steps": {"p50_ms": p50, "p99_ms": p99},
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one JSON object a library."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_experiments.ik_libraries",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cell", default="dawm", help="name or file (default: %(default)s)")
    parser.add_argument("--robot", default="dawm", help="robot of it (default: %(default)s)")
    parser.add_argument("--library", nargs="+", default=list(LIBRARIES), help="default: all")
    parser.add_argument("--duration-s", type=float, default=6.0, help="of each (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        for library in options.library:
            print(json.dumps(run(library, options.cell, options.robot, options.duration_s)), flush=True)
    except ControllerError as error:
        parser.error(str(error))


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.ik_libraries")
