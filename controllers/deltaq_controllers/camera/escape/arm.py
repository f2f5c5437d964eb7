"""The model of the robot that an escape moves: joints, camera, bodies as boxes, spheres around the outer bodies."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.anatomy import anatomy_of, placed_at_first
from deltaq_cell.bodies import Bodies, JointRange
from deltaq_cell.compiled import compiled, inlined, makes_no_array
from deltaq_cell.kernel.arrays import Anatomy, Placed
from deltaq_cell.kernel.place import place
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.kinematics import joints_that_move
from deltaq_controllers.spheres import Spheres
from deltaq_protocol.arrays import Array, Flags, Indices

# Distances of spheres from the tight boxes around bodies, compiled: rough, quick, and never too great.


class BoxedArm(NamedTuple):
    """A robot whose bodies are boxes, and spheres around its outer bodies.

    Attributes:
        anatomy: of the robot and the structure.
        own: (b,) numbers of its own bodies in there.
        inner: (c,) those that only the first joint moves, or none: they cannot get out of the way.
        balls: around its outer bodies; `joints` count from 0 here.
        pairs: (p, 2) sphere and body that are to be kept apart.
        none_wanted: (bodies,) False: of the gate's kernel only the placing of joints is wanted, and of no body.
        no_width: (n,) zeros: it places one configuration in place of a box of them [rad or m].
        reach: (bodies,) from the centre of each box to its corners [m].
    """

    anatomy: Anatomy
    own: Indices
    inner: Indices
    balls: Spheres
    pairs: Indices
    none_wanted: Flags
    no_width: Array
    reach: Array


@makes_no_array
def place_boxes(arm: BoxedArm, placed: Placed, q: Array) -> None:
    """Place the joints, and the boxes of the own bodies, at configuration `q` (n,)."""
    anatomy = arm.anatomy
    place(anatomy, placed, (0, len(q)), (0, 0), arm.none_wanted, q, arm.no_width)
    for body in arm.own:
        joint = anatomy.carrier[body]
        if joint < 0:
            continue
        rotation, centre = placed.rotation[joint], anatomy.box_centre[body]
        for row in range(3):
            a, b, c = rotation[row, 0], rotation[row, 1], rotation[row, 2]
            shift = placed.translation[joint, row]
            placed.box_centre[body, row] = a * centre[0] + b * centre[1] + c * centre[2] + shift
            for k in range(3):
                edge = anatomy.edges[body, k]
                placed.edges[body, k, row] = a * edge[0] + b * edge[1] + c * edge[2]


@inlined
def gap(
    arm: BoxedArm, placed: Placed, body: int, x: float, y: float, z: float, radius: float, least: float
) -> float:
    """Distance of a sphere at (x, y, z) from a body's box, negative inside; `least` if it is no less [m]."""
    centre = placed.box_centre[body]
    x, y, z = x - centre[0], y - centre[1], z - centre[2]
    reach = least + radius + arm.reach[body]
    if reach < 0.0 or x * x + y * y + z * z > reach * reach:
        return least
    half, edges = arm.anatomy.half_edges[body], placed.edges[body]
    square, deepest = 0.0, -math.inf
    for k in range(3):
        beyond = abs(edges[k, 0] * x + edges[k, 1] * y + edges[k, 2] * z) - half[k]
        deepest = max(deepest, beyond)
        if beyond > 0.0:
            square += beyond * beyond
    return min((math.sqrt(square) if deepest > 0.0 else deepest) - radius, least)


@compiled
def gaps(arm: BoxedArm, placed: Placed) -> Array:
    """(p,) distances of all pairs [m]."""
    distances = np.empty(len(arm.pairs))
    for pair in range(len(arm.pairs)):
        ball, body = arm.pairs[pair]
        at = _ball_at(arm, placed, ball)
        distances[pair] = gap(arm, placed, body, at[0], at[1], at[2], arm.balls.radii[ball], math.inf)
    return distances


@makes_no_array
def least_gap(arm: BoxedArm, placed: Placed, least: float) -> float:
    """The least distance of all pairs; `least` if it is no less [m]."""
    last, at = -1, (0.0, 0.0, 0.0)
    for pair in range(len(arm.pairs)):
        ball, body = arm.pairs[pair]
        if ball != last:
            last, at = ball, _ball_at(arm, placed, ball)
        least = gap(arm, placed, body, at[0], at[1], at[2], arm.balls.radii[ball], least)
    return least


@makes_no_array
def clearance(
    arm: BoxedArm, bodies: Indices, placed: Placed, centres: Array, radii: Array, shift: Array, least: float
) -> float:
    """Least distance of bodies from spheres that were moved by `shift` (3,); `least` if it is no less [m].

    Args:
        arm: the robot.
        bodies: (b,) their numbers, `arm.own` or some of these.
        placed: the robot as placed.
        centres: (m, 3) of the spheres [m].
        radii: (m,) of the spheres [m].
        shift: their displacement [m].
        least: distance beyond which no exact value is needed [m].
    """
    for ball in range(len(radii)):
        x, y, z = centres[ball, 0] + shift[0], centres[ball, 1] + shift[1], centres[ball, 2] + shift[2]
        for body in bodies:
            least = gap(arm, placed, body, x, y, z, radii[ball], least)
    return least


@inlined
def _ball_at(arm: BoxedArm, placed: Placed, ball: int) -> tuple[float, float, float]:
    joint, centre = arm.balls.joints[ball], arm.balls.centres[ball]
    rotation, origin = placed.rotation[joint], placed.translation[joint]
    return (
        origin[0] + rotation[0, 0] * centre[0] + rotation[0, 1] * centre[1] + rotation[0, 2] * centre[2],
        origin[1] + rotation[1, 0] * centre[0] + rotation[1, 1] * centre[1] + rotation[1, 2] * centre[2],
        origin[2] + rotation[2, 0] * centre[0] + rotation[2, 1] * centre[1] + rotation[2, 2] * centre[2],
    )


_SAMPLES = 300
"""Configurations that show which pairs can come near, and which joints carry the camera about."""

_LEADS = 0.5
"""A course leads the joints that move the lens at least this part as far as the one that moves it farthest."""

_APART_M = 0.1
"""A pair of the arm's own bodies that is never farther apart than this is left out [m]."""


class EscapingArm(NamedTuple):
    """The robot.

    Attributes:
        boxed: its anatomy, and what is measured of it.
        lower, upper: (n,) limits of the joints [rad or m].
        max_rate: (n,) [rad/s or m/s].
        max_acceleration: (n,) [rad/s^2 or m/s^2].
        leads: (n,) 1 for joints that a course leads; the others are the view's.
        sees: (n,) 1 for joints that move the camera.
        camera_joint: number of the joint that carries it.
        camera_rotation: (3, 3) of the camera in that joint's frame.
        camera_position: (3,) likewise [m].
    """

    boxed: BoxedArm
    lower: Array
    upper: Array
    max_rate: Array
    max_acceleration: Array
    leads: Array
    sees: Array
    camera_joint: int
    camera_rotation: Array
    camera_position: Array


def arm_of(scene: Scene) -> EscapingArm:
    """The robot with the camera."""
    robot = scene.robot
    frame = robot.model.frames[robot.frame_of("camera")]
    carrier = int(frame.parentJoint)
    leads = _leads(robot)
    return EscapingArm(
        _boxed(scene, leads),
        robot.lower.copy(),
        robot.upper.copy(),
        robot.max_velocity.copy(),
        robot.max_acceleration.copy(),
        leads,
        joints_that_move(robot, np.array([carrier]))[0].astype(np.float64),
        carrier - 1,
        frame.placement.rotation.copy(),
        frame.placement.translation.copy(),
    )


def _leads(robot: RobotModel) -> Array:
    random, data = np.random.default_rng(0), robot.model.createData()
    levers = np.zeros(robot.n)
    for _ in range(_SAMPLES):
        q = random.uniform(robot.lower, robot.upper)
        frame, axes = robot.frame_of("camera"), pin.LOCAL_WORLD_ALIGNED
        jacobian = pin.computeFrameJacobian(robot.model, data, q, frame, axes)
        levers = np.maximum(levers, np.linalg.norm(jacobian[:3], axis=0))
    leads: Array = (levers > _LEADS * levers.max()).astype(np.float64)
    return leads


def _boxed(scene: Scene, leads: Array) -> BoxedArm:
    robot, structure = scene.robot, scene.cell.structure
    anatomy = anatomy_of(robot.model, structure, [Bodies(robot, JointRange(0, 0))])
    spheres = Spheres.of(robot)
    # joints count from 1 here: the bodies that the view moves, beyond those that a course leads
    outer = spheres.joints > np.flatnonzero(leads).max() + 1
    balls = Spheres(spheres.joints[outer] - 1, spheres.centres[outer], spheres.radii[outer])
    own = np.flatnonzero(anatomy.robot >= 0)
    every = np.array([(ball, body) for ball in range(len(balls.radii)) for body in range(len(anatomy.robot))])
    none_wanted = np.zeros(len(anatomy.robot), dtype=np.bool_)
    inner = own[anatomy.carrier[own] <= 0]
    reach = np.linalg.norm(anatomy.half_edges, axis=1)
    boxed = BoxedArm(anatomy, own, inner, balls, every, none_wanted, np.zeros(robot.n), reach)
    return boxed._replace(pairs=every[_matter(robot, anatomy, boxed)])


def _matter(robot: RobotModel, anatomy: Anatomy, boxed: BoxedArm) -> NDArray[np.bool_]:
    """(p,) pairs that some configuration brings together, and others apart, two joints or more between them."""
    random, placed = np.random.default_rng(0), placed_at_first(anatomy)
    low, high = np.full(len(boxed.pairs), np.inf), np.full(len(boxed.pairs), -np.inf)
    for _ in range(_SAMPLES):
        place_boxes(boxed, placed, random.uniform(robot.lower, robot.upper))
        measured = gaps(boxed, placed)
        low, high = np.minimum(low, measured), np.maximum(high, measured)
    carrier: Indices = anatomy.carrier[boxed.pairs[:, 1]]
    standing = anatomy.robot[boxed.pairs[:, 1]] < 0
    inner = carrier < boxed.balls.joints[boxed.pairs[:, 0]] - 1
    matter: NDArray[np.bool_] = (low < 0.0) & (high > _APART_M) & (standing | inner)
    return matter
