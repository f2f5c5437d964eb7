"""The camera follower as a controller: its focus and its obstacles come from the view."""

from __future__ import annotations

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.aim import TOOL, focus_of
from deltaq_controllers.camera.error import view_angle
from deltaq_controllers.camera.follower import CameraFollower
from deltaq_controllers.interface import LastIncrement, View
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.arrays import Array


class CameraController:
    """Looks at the leader's tool, or at a fixed point, from a desired distance.

    Until the leader has been heard the robot is brought to rest.

    Args:
        follower: the follower.
        leader: model of the leader.
        desired_distance_m: desired view distance; may be changed at any time [m].
        focus: (3,) fixed point in the world to look at in place of the leader's tool [m].
        aim_offset_m: (3,) point of the leader's tool to look at, in the tool's frame [m].

    Attributes:
        follower, desired_distance_m, focus, aim_offset_m: as given; all but the first may be changed at any time.
        leader_seen: how the leader is seen, and how old its state is.
        evades_below_m: clearance below which the repulsion (12) acts [m].
    """

    def __init__(
        self,
        follower: CameraFollower,
        leader: RobotModel,
        desired_distance_m: float,
        focus: Array | None = None,
        aim_offset_m: tuple[float, float, float] = TOOL,
    ) -> None:
        self.follower = follower
        self.desired_distance_m = desired_distance_m
        self.focus = focus
        self.aim_offset_m: Array = np.array(aim_offset_m)
        self.evades_below_m = follower.gains.repulsion_range_m
        self._leader = leader
        self._last = LastIncrement(follower.limits.max_ddq)
        self.leader_seen = Foreseen(leader, follower.robot, follower.cycle_s)

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        own, leader = view.own, view.others.get(self._leader.name)
        dq_last = self._last.update(own)
        if leader is None:
            return self.follower.limits.admissible(np.zeros_like(own.q_cmd), own.q_cmd, dq_last)
        self.leader_seen.update(own, leader)
        q_leader = self.leader_seen.ahead() if self.follower.variants.extrapolated_focus else leader.q
        focus = self.focus_at(q_leader)
        return self.follower.increment(
            own.q_cmd, dq_last, focus, q_leader, self.desired_distance_m, leader.time_s
        )

    def focus_at(self, q_leader: Array) -> Array:
        """(3,) the focus in the world for a configuration of the leader [m]."""
        if self.focus is not None:
            return self.focus
        return focus_of(self._leader.forward(q_leader), self.aim_offset_m)

    def clearance(self, q: Array, q_leader: Array) -> float:
        """Least clearance of bounding spheres from the leader's and from the floor [m]."""
        return self.follower.clearance_at(q, q_leader)

    def errors(self, q: Array, q_leader: Array) -> tuple[float, float]:
        """View angle error [rad] and view distance less the desired one [m], at measured configurations."""
        T_world_camera = self.follower.robot.camera_pose(q)
        focus, lens = self.focus_at(q_leader), T_world_camera[:3, 3]
        distance = float(np.linalg.norm(focus - lens))
        return view_angle(T_world_camera[:3, :3], lens, focus), distance - self.desired_distance_m
