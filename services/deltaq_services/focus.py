"""Position of a camera's target in the world, to mark it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from deltaq_protocol.messages import ToolPose, Vector3, ViewTarget
from deltaq_protocol.messages.motion import AIM_M


def focus_of(target: ViewTarget, T_world_tool: ToolPose | None) -> Vector3 | None:
    """Position of a target in the world [m]; None if it is on a tool whose pose is unknown.

    Args:
        target: the target of a camera.
        T_world_tool: pose of the tool of the robot that the target names.
    """
    if target.focus_m is not None:
        return target.focus_m
    if T_world_tool is None:
        return None
    w, x, y, z = T_world_tool.quaternion_wxyz
    placed = pin.XYZQUATToSE3(np.array([*T_world_tool.position, x, y, z, w]))
    x, y, z = placed.act(np.array(target.aim_offset_m or AIM_M)).tolist()
    return x, y, z
