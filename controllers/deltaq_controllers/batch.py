"""Kinematics of many configurations at once, vectorised with numpy; pinocchio computes one at a time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array


@dataclass
class FrameBatch:
    """Joint frames of N configurations, in world coordinates.

    Attributes:
        rotation: per joint (N, 3, 3).
        position: per joint (N, 3) [m].
        columns: what `BatchKinematics.columns` returns, once it has been asked for.
    """

    rotation: list[Array]
    position: list[Array]
    columns: tuple[Array, Array] | None = None


class BatchKinematics:
    """A robot's joints, prepared for many configurations at once.

    Args:
        robot: its model.

    Attributes:
        n: number of joints.
        parents: index of the joint that carries each joint; -1 is the world.
        axes: (n, 3) unit vector of each joint in its own frame.
        revolute: (n,) True for revolute joints.
        moves: (n, n) `moves[i, j]`: whether joint j moves the bodies on joint i.
    """

    def __init__(self, robot: RobotModel) -> None:
        model = robot.model
        self.robot = robot
        self.n = robot.n
        self.parents = [int(model.parents[joint]) - 1 for joint in range(1, self.n + 1)]
        self.revolute = robot.revolute
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        self.axes = np.zeros((self.n, 3))
        self.moves = np.zeros((self.n, self.n), dtype=np.bool_)
        for joint in range(self.n):
            column = np.reshape(pin.getJointJacobian(model, data, joint + 1, pin.LOCAL), (6, self.n))[
                :, joint
            ]
            self.axes[joint] = column[3:] if self.revolute[joint] else column[:3]
            self.moves[joint, [other - 1 for other in model.supports[joint + 1] if other > 0]] = True
        self._places = [model.jointPlacements[joint + 1] for joint in range(self.n)]
        # a turn by q about axis k is I + sin(q) [k]x + (1 - cos(q)) [k]x^2
        crosses = [pin.skew(axis) for axis in self.axes]
        self._turns = [
            (place.rotation.copy(), place.rotation @ cross, place.rotation @ cross @ cross)
            for place, cross in zip(self._places, crosses, strict=True)
        ]

    @cached_property
    def hands(self) -> list[tuple[int, Array, Array]]:
        """Of each hand: the joint that carries it, and (3, 3) rotation and (3,) position in that joint's frame."""
        frames = [self.robot.model.frames[self.robot.frame_of(hand)] for hand in self.robot.hands]
        return [
            (int(frame.parentJoint) - 1, frame.placement.rotation.copy(), frame.placement.translation.copy())
            for frame in frames
        ]

    def frames(self, q: Array, joints: list[int] | None = None, carrier: int = -1) -> FrameBatch:
        """Place the robot.

        Args:
            q: (N, n) configurations; only the columns of `joints` and of those that carry them count.
            joints: which to place, each after those that carry it; all if not given. Others stay empty.
            carrier: joint in whose frame they are placed in place of the world's; it carries them all.
        """
        rotation: list[Array] = [np.empty(0)] * self.n
        position: list[Array] = [np.empty(0)] * self.n
        for joint in range(self.n) if joints is None else joints:
            parent = -1 if self.parents[joint] == carrier else self.parents[joint]
            parent_R, parent_p = self._carrier(rotation, position, parent, len(q))
            place = self._places[joint].translation
            if self.revolute[joint]:
                still, sine, versine = self._turns[joint]
                angle = q[:, joint, None, None]
                local: Array = still + np.sin(angle) * sine + (1.0 - np.cos(angle)) * versine
                rotation[joint] = parent_R @ local
                position[joint] = parent_p + parent_R @ place
            else:
                slide = place + q[:, joint, None] * (self._turns[joint][0] @ self.axes[joint])
                rotation[joint] = parent_R @ self._turns[joint][0]
                position[joint] = parent_p + (parent_R @ slide[:, :, None])[:, :, 0]
        return FrameBatch(rotation, position)

    def mounts(self, frames: FrameBatch, joint: int, count: int) -> Array:
        """(N, 4, 4) pose of a joint's frame where its own angle is zero.

        Args:
            frames: with the joint that carries it placed.
            joint: its index.
            count: N.
        """
        parent_R, parent_p = self._carrier(frames.rotation, frames.position, self.parents[joint], count)
        T = np.zeros((count, 4, 4))
        T[:, :3, :3] = parent_R @ self._turns[joint][0]
        T[:, :3, 3] = parent_p + parent_R @ self._places[joint].translation
        T[:, 3, 3] = 1.0
        return T

    def columns(self, frames: FrameBatch) -> tuple[Array, Array]:
        """Per joint its axis (N, n, 3) and the position of its frame (N, n, 3), in world coordinates."""
        if frames.columns is None:
            axes = np.stack([R @ axis for R, axis in zip(frames.rotation, self.axes, strict=True)], axis=1)
            frames.columns = axes, np.stack(frames.position, axis=1)
        return frames.columns

    def hand_jacobians(self, frames: FrameBatch) -> Array:
        """(N, h, 6, n) Jacobian of each hand, linear over angular, world axes; all joints are placed."""
        points = [
            (joint, frames.position[joint] + frames.rotation[joint] @ place) for joint, _, place in self.hands
        ]
        return np.stack([self.jacobian(frames, *point) for point in points], axis=1)

    def jacobian(self, frames: FrameBatch, joint: int, points: Array) -> Array:
        """(N, 6, n) Jacobian of a point that a joint carries, linear over angular, world axes.

        Args:
            frames: all joints placed.
            joint: index of the joint that carries the point.
            points: (N, 3) its positions in the world [m].
        """
        axes, origins = self.columns(frames)
        turning = np.cross(axes, points[:, None] - origins)
        linear = np.where(self.revolute[:, None], turning, axes)
        angular = np.where(self.revolute[:, None], axes, 0.0)
        columns: Array = np.concatenate([linear, angular], axis=2) * self.moves[joint][:, None]
        return columns.transpose(0, 2, 1)

    @staticmethod
    def _carrier(
        rotation: list[Array], position: list[Array], parent: int, count: int
    ) -> tuple[Array, Array]:
        if parent < 0:
            return np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
        return rotation[parent], position[parent]
