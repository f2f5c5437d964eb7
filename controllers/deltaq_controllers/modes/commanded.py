"""What an operator commands, as a motion of the joints and hands that a mode drives."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.modes.hands import Hands
from deltaq_controllers.modes.held_object import HeldObject
from deltaq_controllers.modes.interface import TeleoperationMode
from deltaq_controllers.modes.motion import HAND_AXES, Frame, Motion, OperatorCommand
from deltaq_protocol.arrays import Array


def commanded(
    command: OperatorCommand,
    robot: RobotModel,
    hands: Hands,
    mode: TeleoperationMode,
    frame: Frame,
    held: HeldObject | None,
    q: Array,
) -> Motion:
    """The motion that a mode of joints or of hands is asked for.

    Args:
        command: of the operator.
        robot: the driven robot.
        hands: its hands; they are placed anew.
        mode: the mode that drives it.
        frame: the axes in which hands are moved.
        held: the object between the hands, which then moves in their place.
        q: (n,) where the robot is [rad or m].
    """
    motion, joints = Motion.rest(robot.n, len(hands.names)), robot.joint_names
    for axis, rate in command.rates.items():
        hand, _, plain = axis.rpartition(".")
        if axis in joints:
            motion.joints[joints.index(axis)] = rate
        elif plain in HAND_AXES and (not hand or hand in hands.names):
            rows = hands.names.index(hand) if hand else slice(None)
            motion.hands[rows, HAND_AXES.index(plain)] = rate
    motion.joints[~mode.drives_joints] = 0.0
    if not mode.drives_hands:
        motion.hands[:] = 0.0
        return motion
    hands.update(q)
    if held is not None:
        axes = held.axes(hands.rotations) if frame is Frame.TOOL else np.eye(3)
        motion.hands[:] = held.hands_twists(hands.positions, _turned(axes, motion.hands[0]))
    elif frame is Frame.TOOL:
        for hand_twist, axes in zip(motion.hands, hands.rotations, strict=True):
            hand_twist[:] = _turned(axes, hand_twist)
    return motion


def _turned(axes: Array, twist: Array) -> Array:
    """A twist (6,) in axes (3, 3), in those of the world."""
    return np.concatenate([axes @ twist[:3], axes @ twist[3:]])
