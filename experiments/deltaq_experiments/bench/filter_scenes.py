"""Scenes on which `deltaq bench filters` compares filters, and distances on their meshes.

`Distances` is independent of the gate: coal measures the meshes themselves, without hulls and the gate's kernel.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from deltaq import Box, Gate
from deltaq.foreign_robot import whole_body
from deltaq.obstacles import Obstacle
from deltaq_cell.models import collision_names, load_urdf
from deltaq_cell.urdf_parsing import parse_geometry, parse_model
from deltaq_protocol.arrays import Array, Indices

CYCLE_S = 0.004
STOP_M, SELF_STOP_M = 0.02, 0.005
"""Stop distances of the scenes that come with deltaq: the defaults of `deltaq.Gate` [m]."""
ROBOT = "kr16"
HOME = (0.0, -1.57, 1.57, 0.0, 0.5, 0.0)
"""Where its arm starts, upper arm upright and forearm level [rad]."""
ALLOWED_M = 0.001
"""What counts as clear is this much farther apart than the stop distances: a filter may be so much more careful [m]."""
BOXES, PATHS = 8, 2
NEAR_M = 0.06
"""A path comes nearer to a body than this, and all boxes are farther from the arm at its start [m]."""


@dataclass(frozen=True, eq=False)
class FilterScene:
    """An arm among bodies: what a filter may know.

    Attributes:
        urdf: file or name of the robot's model.
        obstacles: bodies by name, such as `Box(size_m, at=, rpy=)`, in the world.
        cycle_s: time between two calls [s].
        stop_distance_m, self_stop_distance_m: least distances from obstacles and between links [m].
        q: (n,) start of the adversaries' trials [rad or m].
        lower, upper, max_velocity, max_acceleration: (n,) limits [rad or m, per s, per s^2].
        left_out: pairs of bodies of the robot that may touch, such as neighbours.
        srdf: file with pairs of links that are left out, for the gate; None if there is none.
        locked: joints that do not move, and their positions [rad or m].
        paths: (k, n) setpoints of each path, clear by the stop distances; the first is where it starts [rad or m].
    """

    urdf: str
    obstacles: Mapping[str, Obstacle]
    cycle_s: float
    stop_distance_m: float
    self_stop_distance_m: float
    q: Array
    lower: Array
    upper: Array
    max_velocity: Array
    max_acceleration: Array
    left_out: frozenset[frozenset[str]]
    srdf: str | None = None
    locked: Mapping[str, float] = field(default_factory=dict)
    paths: list[Array] = field(default_factory=list)

    @classmethod
    def of(cls, gate: Gate, urdf: str, srdf: str | None = None) -> FilterScene:
        """The scene of a gate that `Gate.from_urdf` made."""
        robot, cell = gate.cell.robots["arm"], gate.cell.description
        never, found = robot.never_checked_pairs(), defaultdict[bool, set[frozenset[str]]](set)
        for pair in combinations(sorted(body.name for body in robot.geometry.geometryObjects), 2):
            found[pair in never].add(frozenset(whole_body(name.removeprefix("arm/")) for name in pair))
        return cls(
            urdf, gate.obstacles, cell.cycle_s, cell.gate.stop_distance_m, cell.gate.self_stop_distance_m,
            gate.q_cmd(), robot.lower, robot.upper, robot.max_velocity, robot.max_acceleration,
            frozenset(found[True] - found[False]), srdf, robot.description.locked_joints,
        )  # fmt: skip


class Distances:
    """Distances of an arm's bodies from one another and from obstacles, on the meshes.

    Attributes:
        least_m: (pairs,) stop distance of each pair [m].
        own: how many of the pairs are of two links; the others are of a link and an obstacle.
    """

    def __init__(self, scene: FilterScene) -> None:
        source = load_urdf(scene.urdf)
        self._model = parse_model(source, scene.locked)
        self._data = self._model.createData()
        collision = pin.GeometryType.COLLISION
        self._geometry = parse_geometry(source, collision, pin.SE3.Identity(), scene.locked)
        names = collision_names(source)
        bodies = [(*body.name.rsplit("_", 1), body.parentJoint) for body in self._geometry.geometryObjects]
        own = [(names[link][int(number)], int(joint)) for link, number, joint in bodies]
        for name, obstacle in scene.obstacles.items():
            place = pin.SE3(pin.rpy.rpyToMatrix(*obstacle.rpy), np.array(obstacle.at, dtype=np.float64))
            self._geometry.addGeometryObject(pin.GeometryObject(name, 0, place, _shape(obstacle)))
        links = range(len(own))
        pairs = [
            (i, j)
            for i in links
            for j in links[i + 1 :]
            if own[i][1] != own[j][1] and frozenset((own[i][0], own[j][0])) not in scene.left_out
        ]
        self.own = len(pairs)
        others = range(len(own), len(self._geometry.geometryObjects))
        pairs += [(i, j) for i in links if own[i][1] for j in others]
        self.least_m = np.full(len(pairs), scene.stop_distance_m)
        self.least_m[: self.own] = scene.self_stop_distance_m
        joints = [joint for _, joint in own] + [0] * len(others)
        self._joints = [(joints[i], joints[j]) for i, j in pairs]
        bodies_of = [*(name for name, _ in own), *scene.obstacles]
        self._names = [frozenset((bodies_of[i], bodies_of[j])) for i, j in pairs]
        for pair in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(*pair))
        self._measured, self._asked, self._touching = (self._geometry.createData() for _ in range(3))
        self._first, self._second = np.array(pairs).reshape(-1, 2).T
        shapes = [body.geometry for body in self._geometry.geometryObjects]
        for shape in shapes:
            shape.computeLocalAABB()
        self._middles = [shape.aabb_center for shape in shapes]
        self._reach_m = np.array([shape.aabb_radius for shape in shapes])

    def clear(self, q: Array, more_m: float = ALLOWED_M) -> bool:
        """Whether all pairs keep their stop distances, and `more_m` beyond them, at `q` (n,)."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._asked, q)
        asked_m = self.least_m + more_m
        for pair in np.flatnonzero(self._at_least_m() <= asked_m).tolist():
            self._asked.collisionRequests[pair].security_margin = asked_m[pair]
            if pin.computeCollision(self._geometry, self._asked, pair):
                return False
        return True

    def _at_least_m(self) -> Array:
        """(pairs,) distances of the balls that coal has around bodies; those of the bodies are no less [m]."""
        placed = zip(self._asked.oMg, self._middles, strict=True)
        centres = np.array([place.act(middle) for place, middle in placed])
        apart = np.linalg.norm(centres[self._first] - centres[self._second], axis=1)
        at_least_m: Array = apart - self._reach_m[self._first] - self._reach_m[self._second]
        return at_least_m

    def depth_m(self, q: Array) -> float:
        """How deep two bodies are in one another at `q` (n,); 0 if none touch [m]."""
        if not pin.computeCollisions(self._model, self._data, self._geometry, self._touching, q, True):
            return 0.0
        return max(1e-6, -float(self.measure(q).min()))

    def measure(self, q: Array) -> Array:
        """(pairs,) distances at `q` (n,); negative where two bodies overlap [m]."""
        pin.computeDistances(self._model, self._data, self._geometry, self._measured, q)
        return np.array([found.min_distance for found in self._measured.distanceResults])

    def distance_m(self, q: Array, one: str, other: str) -> float:
        """Distance of two bodies of the URDF, or of one and an obstacle, at `q` (n,) [m]."""
        return float(self.measure(q)[self._names.index(frozenset((one, other)))])

    def gradients(self, q: Array, pairs: Indices) -> Array:
        """(k, n) change of the distances of some pairs with `q`, which was measured last [m/rad or 1]."""
        pin.computeJointJacobians(self._model, self._data, q)
        rows = np.zeros((len(pairs), self._model.nv))
        for row, number in zip(rows, pairs, strict=True):
            found, (joint, other) = self._measured.distanceResults[int(number)], self._joints[number]
            one, two = found.getNearestPoint1(), found.getNearestPoint2()
            # coal gives no normal between two meshes
            normal = (two - one) / found.min_distance if abs(found.min_distance) > 1e-6 else found.normal
            row -= normal @ self._velocity(joint, one)
            if other:
                row += normal @ self._velocity(other, two)
        return rows

    def _velocity(self, joint: int, point: Array) -> Array:
        """(3, n) velocity of a point that moves with a joint."""
        J = pin.getJointJacobian(self._model, self._data, joint, pin.LOCAL_WORLD_ALIGNED)
        moved: Array = J[:3] - pin.skew(point - self._data.oMi[joint].translation) @ J[3:]
        return moved


def _shape(obstacle: Obstacle) -> Any:
    kinds = {"box": coal.Box, "cylinder": coal.Cylinder, "capsule": coal.Capsule, "sphere": coal.Sphere}
    sizes = obstacle.shape()
    return kinds[sizes.pop("kind")](*np.hstack(list(sizes.values())))


@cache
def drawn_scene(seed: int, urdf: str = ROBOT, home: tuple[float, ...] = HOME) -> FilterScene:
    """A robot, at `home`, among boxes that are drawn from a seed, with straight paths that pass near a body."""
    rng = np.random.default_rng(seed)
    bare = FilterScene.of(Gate.from_urdf(urdf, CYCLE_S, q=home), urdf)
    boxes: dict[str, Obstacle] = {}
    while len(boxes) < BOXES:
        size_m = rng.uniform(0.1, 0.4, 3).tolist()
        box = Box(size_m, at=tuple(rng.uniform((-1.6, -1.6, 0.0), (1.6, 1.6, 1.8))))
        alone = Distances(replace(bare, obstacles={"box": box}))
        if alone.measure(bare.q)[alone.own :].min() > NEAR_M:
            boxes[f"box_{len(boxes)}"] = box
    scene = replace(bare, obstacles=boxes)
    distances = Distances(scene)
    while len(scene.paths) < PATHS:
        goal = rng.uniform(np.maximum(scene.lower, scene.q - 1.5), np.minimum(scene.upper, scene.q + 1.5))
        path = timed(scene.q, goal, scene.max_velocity, scene.max_acceleration, CYCLE_S)
        nearest_m = min(distances.measure(q)[distances.own :].min() for q in path[::8])
        if nearest_m < NEAR_M and all(map(distances.clear, path)):
            scene.paths.append(path)
    return scene


def timed(one: Array, other: Array, velocity: Array, acceleration: Array, cycle_s: float) -> Array:
    """(k, n) setpoints of all cycles from `one` to `other`, from rest to rest in the least time within the limits."""
    travel = np.maximum(np.abs(other - one), 1e-12)
    rate = float((acceleration / travel).min())
    speed = min(float((velocity / travel).min()), np.sqrt(rate))
    ramp_s, length_s = speed / rate, 1 / speed + speed / rate
    t = np.minimum(np.arange(np.ceil(length_s / cycle_s) + 1) * cycle_s, length_s)
    up, down = rate * t**2 / 2, 1 - rate * (length_s - t) ** 2 / 2
    share = np.where(t < ramp_s, up, np.where(t > length_s - ramp_s, down, speed * (t - ramp_s / 2)))
    line: Array = one + share[:, None] * (other - one)
    return line
