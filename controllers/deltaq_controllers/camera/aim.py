"""What a camera looks at: a point of the leader's tool, or a point that stands still."""

from __future__ import annotations

import numpy as np

from deltaq_protocol.arrays import Array

TOOL = (0.0, 0.0, 0.0)
"""The origin of the tool's frame, in that frame [m]."""


def focus_of(T_world_tool: Array, aim_offset_m: Array) -> Array:
    """(3,) a point of a tool in the world [m].

    Args:
        T_world_tool: (4, 4) pose of the tool.
        aim_offset_m: (3,) the point in the tool's frame [m].
    """
    focus: Array = T_world_tool[:3, 3] + T_world_tool[:3, :3] @ np.asarray(aim_offset_m, dtype=np.float64)
    return focus
