"""Planes, pair by pair: each shows exactly the room that its formula gives, and none that a motion takes.

The formulas are those of `docs/explanation/the-gate.md`, written here with a loop for every sum.
"""

from dataclasses import dataclass
from itertools import product

import coal
import numpy as np
import pinocchio as pin
import pytest
from uncompiled import uncompiled

from deltaq_cell.bodies import Extents
from deltaq_cell.kernel.arrays import Anatomy, Placed
from deltaq_cell.kernel.span import VERTICES as MOST_VERTICES

keeps = uncompiled("look").keeps

ROBOTS = {"one": (0, 1, 2, 3, 4), "other": (5, 6)}
PRISMATIC = (0, 3, 6)
JOINTS = 7
SHAPES = {
    "one/link": (coal.Box(0.2, 0.3, 0.4), (0, 1)),
    "one/left": (coal.Cylinder(0.1, 0.5), (0, 1, 2)),
    "one/hand": (coal.Sphere(0.1), (0, 1, 2, 3)),
    "one/right": (coal.Box(0.1, 0.2, 0.3), (0, 1, 4)),
    "other/arm": (coal.Capsule(0.07, 0.3), (5,)),
    "other/hand": (coal.Cylinder(0.2, 0.1), (5, 6)),
    "floor": (coal.Cylinder(0.5, 0.1), ()),
    "wall": (coal.Sphere(0.4), ()),
}
PAIRS = [
    ("one/left", "floor"),
    ("wall", "one/hand"),
    ("one/link", "one/hand"),
    ("one/hand", "one/left"),
    ("one/right", "one/hand"),
    ("one/left", "one/right"),
    ("one/left", "other/hand"),
    ("other/arm", "one/link"),
    ("other/hand", "one/right"),
    ("one/hand", "other/arm"),
]


STILL = np.zeros(3)
VERTICES = {"one": 3, "other": 2, "structure": 1}


@dataclass
class Body:
    corners: np.ndarray
    axis: np.ndarray
    disc: float
    ball: float
    moved_by: tuple[int, ...]
    owner: str

    def reach(self, n):
        """Support function: how far the body reaches along n."""
        across = n - (self.axis @ n) * self.axis
        return max(corner @ n for corner in self.corners) + self.disc * norm(across) + self.ball * norm(n)


def norm(vector):
    return float(np.linalg.norm(vector))


class Scene:
    """Two robots, a floor and a wall, within spans; with turns and lengths as large as they are given."""

    def __init__(self, random, length=0.1, width=0.01):
        self.random = random
        self.axes = [unit(random) for _ in range(JOINTS)]
        self.axes[2] = np.array([1.0, 0.0, 0.0])  # as an axis may be that has two zeros
        self.points = random.uniform(-1, 1, (JOINTS, 3))
        self.offsets = {
            owner: random.uniform(-1, 1, (count, JOINTS))
            * length
            * np.isin(range(JOINTS), ROBOTS.get(owner, ()))
            for owner, count in VERTICES.items()
        }
        self.along = sum(np.abs(offsets).max(axis=0) for offsets in self.offsets.values())
        self.deviation = random.uniform(0, 1, JOINTS) * width
        self.bodies = {name: self.drawn(name) for name in SHAPES}
        self.cell, self.placed = self.as_the_kernel_has_it()

    def drawn(self, name):
        extents = Extents([pin.GeometryObject(name, 0, somewhere(self.random), SHAPES[name][0])])
        shape = (extents.corners[0], extents.axis[0], extents.disc[0], extents.ball[0])
        robot = name.partition("/")[0]
        return Body(*shape, SHAPES[name][1], robot if robot in ROBOTS else "structure")

    def as_the_kernel_has_it(self):
        bodies, names = list(self.bodies.values()), list(self.bodies)
        joints = [ROBOTS.get(body.owner, ()) for body in bodies]
        corners = np.zeros((len(bodies), max(len(body.corners) for body in bodies), 3))
        for number, body in enumerate(bodies):
            corners[number, : len(body.corners)] = body.corners
        offset = np.zeros((MOST_VERTICES, JOINTS))
        for robot, among in ROBOTS.items():
            offset[: VERTICES[robot], among] = self.offsets[robot][:, among]
        cell = dict.fromkeys(Anatomy._fields) | {
            "robot": [[*ROBOTS, "structure"].index(body.owner) if body.moved_by else -1 for body in bodies],
            "carrier": [body.moved_by[-1] if body.moved_by else -1 for body in bodies],
            "first_joint": [among[0] if among else 0 for among in joints],
            "last_joint": [among[-1] + 1 if among else 0 for among in joints],
            "moved_by": np.array([[joint in body.moved_by for joint in range(JOINTS)] for body in bodies]),
            "revolute": [joint not in PRISMATIC for joint in range(JOINTS)],
            "corner_count": [len(body.corners) for body in bodies],
            "disc": [body.disc for body in bodies],
            "ball": [body.ball for body in bodies],
        }
        placed = dict.fromkeys(Placed._fields) | {
            "columns": np.array([self.twist(joint, 1.0) for joint in range(JOINTS)]),
            "half": self.along + self.deviation,
            "vertices": [VERTICES[robot] for robot in ROBOTS],
            "offset": offset,
            "along": self.along,
            "deviation": self.deviation,
            "corners": corners,
            "axis": np.array([body.axis for body in bodies]),
            "arms": np.array([[self.arm(name, joint) for joint in range(JOINTS)] for name in names]),
        }
        return Anatomy(**cell), Placed(**placed)

    def arm(self, name, joint):
        """Greatest distance of a point of a body from a joint's axis, 1 if that is prismatic or moves it not."""
        if joint in PRISMATIC or joint not in SHAPES[name][1]:
            return 1.0
        body = self.bodies[name]
        from_axis = [norm(np.cross(self.axes[joint], corner - self.points[joint])) for corner in body.corners]
        return max(from_axis) + body.disc + body.ball

    def twist(self, joint, rate):
        """Velocity of the world's origin and rate of turning under one joint."""
        axis = rate * self.axes[joint]
        if joint in PRISMATIC:
            return np.concatenate([axis, np.zeros(3)])
        return np.concatenate([np.cross(self.points[joint], axis), axis])

    def keeps(self, pairs, normals, distances, asked):
        number = list(self.bodies).index
        return [
            keeps(self.cell, self.placed, *map(number, pair), *of_pair, np.zeros((2, MOST_VERTICES, 6)))
            for pair, *of_pair in zip(pairs, normals, distances, asked, strict=True)
        ]

    def apart(self, pair):
        """Joints that move one of two bodies and not the other, for each of the two."""
        mine, theirs = (set(SHAPES[name][1]) for name in pair)
        return sorted(mine - theirs), sorted(theirs - mine)

    def to_vertex(self, name, vertex, joints):
        """How a body moves from the middle of the span to a vertex, by some joints."""
        offset = self.offsets[self.bodies[name].owner][vertex]
        return sum((self.twist(joint, offset[joint]) for joint in joints), start=np.zeros(6))

    def blur(self, pair):
        """What deviations and all that is of second order may take from a gap."""
        half, total = self.along + self.deviation, 0.0
        for name, joints in zip(pair, self.apart(pair), strict=True):
            travel = sum(half[joint] * self.arm(name, joint) for joint in joints)
            total += sum(self.deviation[joint] * self.arm(name, joint) for joint in joints)
            for outer in joints:
                inner = sum(half[joint] for joint in joints if joint < outer and joint not in PRISMATIC)
                itself = 0.0 if outer in PRISMATIC else half[outer] / 2
                total += half[outer] * (self.arm(name, outer) + travel) * (inner + itself)
        return total

    def vertices(self, pair):
        """Which vertices of the spans the two bodies may be at: bodies of one robot are at the same."""
        first, second = (self.bodies[name].owner for name in pair)
        every = product(range(VERTICES[first]), range(VERTICES[second]))
        return [(k, m) for k, m in every if k == m or first != second]

    def gap(self, pair, n, turned_by=None):
        """Least gap along a plane that stands, or that turns with one of the bodies, to first order."""
        gaps = []
        for vertices in self.vertices(pair):
            turn = STILL if turned_by is None else self.turn(pair, n, turned_by, vertices[turned_by])
            reach = 0.0
            for side, (name, joints) in enumerate(zip(pair, self.apart(pair), strict=True)):
                sign, (v, w) = (1, -1)[side], self.to_vertex(name, vertices[side], joints).reshape(2, 3)
                along = n + turn + np.cross(n, w)
                reach += self.bodies[name].reach(sign * along) + sign * (n @ v)
            gaps.append(-reach)
        return min(gaps)

    def turn(self, pair, n, body, vertex):
        """How the normal of a plane changes that turns with a body to a vertex."""
        return np.cross(self.to_vertex(pair[body], vertex, self.apart(pair)[body])[3:], n)

    def room_of_a_standing_plane(self, pair, n):
        return self.gap(pair, n) - self.blur(pair)

    def room_of_a_turning_plane(self, pair, n, body):
        vertices = range(VERTICES[self.bodies[pair[body]].owner])
        angle = max(norm(self.turn(pair, n, body, vertex)) for vertex in vertices)
        travel = sum(
            self.along[joint] * self.arm(name, joint)
            for name, joints in zip(pair, self.apart(pair), strict=True)
            for joint in joints
        )
        left = self.gap(pair, n, body) - angle * travel
        return (left / np.sqrt(1 + angle**2) if left > 0 else left) - self.blur(pair)

    def rooms(self, pair, n):
        turning = [self.room_of_a_turning_plane(pair, n, body) for body in (0, 1)]
        return [self.room_of_a_standing_plane(pair, n), *turning]


def unit(random):
    vector = random.normal(size=3)
    return vector / norm(vector)


def somewhere(random):
    return pin.SE3(pin.exp3(3 * unit(random)), random.uniform(-1, 1, 3))


def normal(scene, pair, random):
    """From the first body to the second, or any other way."""
    first, second = (scene.bodies[name].corners.mean(axis=0) for name in pair)
    return (second - first) / norm(second - first) if random.uniform() < 0.7 else unit(random)


FAR = [10.0] * len(PAIRS)


@pytest.fixture(
    scope="module", params=[(seed, length) for seed in range(1, 4) for length in (0.01, 0.05, 0.3)]
)
def drawn(request):
    """A scene, a normal for each pair, and the rooms of a standing and two turning planes."""
    seed, length = request.param
    random = np.random.default_rng(seed)
    scene = Scene(random, length)
    normals = [normal(scene, pair, random) for pair in PAIRS]
    return scene, normals, np.array([scene.rooms(pair, n) for pair, n in zip(PAIRS, normals, strict=True)])


@pytest.mark.by_day(4)
def test_planes_give_the_clearance_of_their_formula(drawn):
    scene, normals, rooms = drawn
    most = rooms.max(axis=1)
    assert all(scene.keeps(PAIRS, normals, FAR, most - 1e-9))
    assert not any(scene.keeps(PAIRS, normals, FAR, most + 1e-9))


def test_each_pair_is_judged_independently(drawn):
    scene, normals, rooms = drawn
    every_second = np.arange(len(PAIRS)) % 2
    asked = rooms.max(axis=1) + np.where(every_second, -1e-9, 1e-9)
    assert scene.keeps(PAIRS, normals, FAR, asked) == [False, True] * 5
    for index, pair in enumerate(PAIRS):
        alone = scene.keeps([pair], [normals[index]], [10.0], [asked[index]])
        assert alone == [bool(every_second[index])]


def test_bodies_too_near_at_the_midpoint_skip_the_plane_test(drawn):
    scene, normals, rooms = drawn
    asked = np.maximum(rooms.max(axis=1), 0.0) - 1e-9
    kept = scene.keeps(PAIRS, normals, asked - 1e-6, asked)
    assert all(item is False for item in kept)
