"""The record of a run, and the figures that follow from it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.controllers import FocusController
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.camera.subtasks import LEVEL_RATIO, roll
from deltaq_experiments.report import LeastClearance, ReachedSpeed
from deltaq_protocol.arrays import Array
from deltaq_testing.oracle import ClearanceOracle, LimitCounts, limit_violations

PEAK_OVER_S = 0.06
"""Time over which a speed counts: stamps of a live run are off by a part of a cycle."""


@dataclass(frozen=True)
class Trace:
    """A recorded run.

    Attributes:
        time_s: (k,) since the beginning.
        q: per robot (k, n) measured configurations at these times [rad or m].
        setpoints: per robot (m, n) consecutive setpoints of the emulated controller [rad or m].
        krc_cycle_s: per robot the time between two of them, by the controller's own record; the cell's if not given.
    """

    time_s: Array
    q: Mapping[str, Array]
    setpoints: Mapping[str, Array]
    krc_cycle_s: Mapping[str, float] = field(default_factory=dict)

    def views(self, camera: FocusController, scene: Scene) -> Array:
        """(k, 2) view angle error [deg] and view distance [m] of the measured configurations.

        Args:
            camera: controller with the camera and its focus.
            scene: the roles of the robots.
        """
        pairs = zip(self.q[scene.robot_name], self.q[scene.leader_name], strict=True)
        both: Array = np.array([camera.errors(q, q_leader) for q, q_leader in pairs])
        both *= np.array([180.0 / np.pi, 1.0])
        both[:, 1] += camera.desired_distance_m
        return both

    def clearances(self, camera: FocusController, scene: Scene) -> Array:
        """(k,) clearance as the controller measures it [m]."""
        pairs = zip(self.q[scene.robot_name], self.q[scene.leader_name], strict=True)
        return np.array([camera.clearance(q, q_leader) for q, q_leader in pairs])

    def near_limit(self, robot: RobotModel, share: float = 0.03) -> NDArray[np.bool_]:
        """(k,) whether a joint is within the fraction `share` of its range of a limit."""
        q, margin = self.q[robot.name], share * (robot.upper - robot.lower)
        near: NDArray[np.bool_] = (q < robot.lower + margin) | (q > robot.upper - margin)
        return np.asarray(near.any(axis=1))

    def rolls(self, robot: RobotModel) -> Array:
        """(k,) by how much the picture of the robot's camera is turned about the view axis [deg].

        Zero where the camera looks straight up or down, where no picture is level.
        """
        rotations = [robot.camera_pose(q)[:3, :3] for q in self.q[robot.name]]
        is_level = [math.hypot(R[2, 0], R[2, 1]) < LEVEL_RATIO for R in rotations]
        return np.array(
            [0.0 if no else math.degrees(roll(R)) for no, R in zip(is_level, rotations, strict=True)]
        )

    def points(self, robot: RobotModel) -> Array:
        """(k, 3) the tool in the world [m]."""
        return np.array([robot.forward(q)[:3, 3] for q in self.q[robot.name]])

    def reached_speed(self, robot: RobotModel, settle_s: float = 0.0) -> ReachedSpeed:
        """How fast the tool went from `settle_s` on, or in all of a run that is shorter."""
        settled = self.time_s >= settle_s
        counted = settled if settled.sum() > 1 else np.ones_like(settled)
        return reached_speed(self.time_s[counted], self.points(robot)[counted])

    def least_clearance(self, cell: CellModel) -> LeastClearance:
        """Least clearance, measured by the independent checker at every recorded time."""
        oracle = ClearanceOracle(cell)
        moments = [{name: q[k] for name, q in self.q.items()} for k in range(len(self.time_s))]
        nearest = min((oracle.between_robots_and_structure(m) for m in moments), key=lambda n: n.distance_m)
        own = min(oracle.of_one_robot(m).distance_m for m in moments)
        robots = float(self.robot_clearances(cell).min(initial=np.inf))
        return LeastClearance(min=nearest.distance_m, pair=nearest.pair, robots_min=robots, self_min=own)

    def robot_clearances(self, cell: CellModel) -> Array:
        """(k,) least distance between bodies of different robots at every recorded time [m]."""
        oracle = ClearanceOracle(cell)
        moments = ({name: q[k] for name, q in self.q.items()} for k in range(len(self.time_s)))
        return np.array([oracle.between_robots(moment).distance_m for moment in moments])

    def limit_counts(self, cell: CellModel) -> LimitCounts:
        """Counted from the emulated controllers' setpoints."""
        return LimitCounts.sum(
            limit_violations(
                cell.robots[name], setpoints, self.krc_cycle_s.get(name, cell.description.cycle_s)
            )
            for name, setpoints in self.setpoints.items()
        )


def reached_speed(time_s: Array, points: Array) -> ReachedSpeed:
    """How fast a point went that was at `points` (k, 3) [m] at the times (k,) [s], two at least."""
    way_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    later = np.searchsorted(time_s, time_s + PEAK_OVER_S - 1e-9)
    first = np.flatnonzero(later < len(time_s))
    if not first.size:  # a run shorter than that
        first, later = np.array([0]), np.array([len(time_s) - 1])
    last = later[first]
    return ReachedSpeed(
        mean=float(way_m[-1] / (time_s[-1] - time_s[0])),
        peak=float(((way_m[last] - way_m[first]) / (time_s[last] - time_s[first])).max()),
    )


def time_to_stay_below(time_s: Array, values: Array, bound: float) -> float | None:
    """When `values` (k,) came to be at most `bound` for good; None if the last one is not."""
    above = np.flatnonzero(~(values <= bound))
    first = int(above[-1]) + 1 if above.size else 0
    return float(time_s[first]) if first < len(values) else None
