"""The model of the robot that an escape moves: joints, camera, bodies as boxes, spheres around the outer bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from deltaq_cell.anatomy import anatomy_of, placed_at_first
from deltaq_cell.bodies import Bodies, JointRange
from deltaq_cell.kernel.arrays import Anatomy
from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.escape.distances import BoxedArm, gaps, place_boxes
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.kinematics import joints_that_move
from deltaq_controllers.spheres import Spheres
from deltaq_protocol.arrays import Array, Indices

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
    boxed = BoxedArm(anatomy, own, inner, balls, every, none_wanted, np.zeros(robot.n))
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
