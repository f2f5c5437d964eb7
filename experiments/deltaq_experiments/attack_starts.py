"""Where an attack begins: both robots somewhere else with every seed."""

from __future__ import annotations

import math
from itertools import count

import numpy as np

from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.leader.attacking import HomingStick, staging_box
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_experiments.starts import LEAST_CLEARANCE_M, MeasuredView, start_with_error
from deltaq_protocol.arrays import Array
from deltaq_verification.oracle import ClearanceOracle

LOOKS_PAST_RAD = math.radians(20.0)
"""By how much the camera misses its focus: it looks there before the first attack has come near."""

_ON_THE_WAY_S = 3.0
_SPEED_M_S = 0.5


def attack_start(scene: Scene, camera: MeasuredView, seed: int) -> dict[str, Array]:
    """Configurations (n,) of both robots [rad or m].

    The leader's tool is at a point of the box that it withdraws to, the follower's camera looks nearly at its focus.

    Args:
        scene: who watches whom.
        camera: measures the view.
        seed: of both.

    Raises:
        DeltaqError: no such configuration of the follower is found.
    """
    oracle, box = ClearanceOracle(scene.cell), staging_box(scene.leader)
    at_home = {name: one.home for name, one in scene.cell.robots.items()}
    for attempt in count():
        follower_seed = seed if attempt == 0 else int(np.random.default_rng((seed, attempt)).integers(2**31))
        q = start_with_error(scene, camera, LOOKS_PAST_RAD, follower_seed)
        point = np.random.default_rng((seed, 1 + attempt)).uniform(box.low, box.high)
        both = {scene.robot_name: q, scene.leader_name: _with_tool_at(scene, point)}
        if oracle.between_robots_and_structure(at_home | both).distance_m > 0.5 * LEAST_CLEARANCE_M:
            return both
    raise AssertionError  # count() does not end


def _with_tool_at(scene: Scene, point: Array) -> Array:
    """(n,) the leader as it arrives from home with its tool at a point (3,) [rad or m]."""
    model, cycle_s = scene.leader, scene.cycle_s
    stick = HomingStick(_SPEED_M_S, cycle_s)
    stick.point = point
    leader, q = ScriptedLeader(model, cycle_s, stick=stick), np.array(model.home)
    for cycle in range(round(_ON_THE_WAY_S / cycle_s)):
        q = q + leader.increment(View(RobotView(cycle, cycle * cycle_s, q, q)))
    return q
