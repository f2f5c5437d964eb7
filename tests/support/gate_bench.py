"""Robots of the lab cell where a test wants them, at rest or in motion, near something or not."""

import numpy as np
from gate_rig import CELL as LAB
from small_cell import server_state
from spans import exact_drives

from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_protocol.guarded import Plan
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import drives_of
from deltaq_testing.oracle import ClearanceOracle

_GATE = LAB.description.gate.model_copy(update={"servo_lag_s": 0.072})
CELL = CellModel.of(LAB.description.model_copy(update={"gate": _GATE}), LAB.robots, LAB.yaml)
"""The lab with quicker drives than its own: what is below was found for their tubes."""
STOP_M = CELL.description.gate.stop_distance_m
PROXIMITY = CompiledProximity(CELL)
ORACLE = ClearanceOracle(CELL)
LIMITS = {name: Limits.of(robot, CELL.description.cycle_s) for name, robot in CELL.description.robots.items()}
HOME = {name: robot.home for name, robot in CELL.robots.items()}
FR_BESIDE_GR = np.array((-0.874, -0.806, 0.250, -1.742, 0.600, 2.117))
GR_BESIDE_FR = np.array((0.860, 1.820, -0.602, 0.577, -1.549, -0.785, 0.551, 0.490, 1.334))
GR_ABOVE_FR = np.array((0.5501, 2.5284, -0.549, 2.2375, -1.0142, 0.8645, 1.4247, 0.2502, 1.747))
"""A little more than the stop distance above FR's lens, where FR stands low over the floor."""


def new_tracker(name):
    """A tracker of a robot that has not been heard, and whose drives are exactly in the hull of their setpoints."""
    robot, cycle_s = CELL.description.robots[name], CELL.description.cycle_s
    lag = drives_of(robot, CELL.description.gate, cycle_s).lag
    return Tracker(name, robot, exact_drives(lag, len(robot.joints), 1e-9), cycle_s)


def at_rest(name, q, measured=None):
    """A tracker of a robot that has stood at `q` for as long as its drives lag; its drives are at `measured`."""
    tracker = new_tracker(name)
    lag = tracker.drives.lag + 1
    here, there = tuple(q.tolist()), tuple((q if measured is None else measured).tolist())
    still = Plan(dq=(0.0,) * q.size, brake_cycles=1, step=1)
    for cycle in range(1, lag + 1):
        tracker.observe(server_state(name, cycle, q=there, q_cmd=here, dq=still.dq, plan=still))
    return tracker


def in_motion(name, q, dq):
    """A tracker of a robot that has come to `q` at a constant `dq` and was admitted it last."""
    tracker = new_tracker(name)
    lag = tracker.drives.lag + 1
    sent = tuple(dq.tolist())
    plan = Plan(dq=sent, brake_cycles=LIMITS[name].brake_cycles(dq), step=0)
    for cycle in range(1, lag + 1):
        here = tuple((q - (lag - cycle) * dq).tolist())
        tracker.observe(server_state(name, cycle, q=here, q_cmd=here, dq=sent, plan=plan))
    return tracker


def one_joint(name, joint, increment):
    request = np.zeros(HOME[name].size)
    request[joint] = increment
    return request


def with_room(room_m, moved, here, joint):
    """Where robot `moved` keeps the stop distance with `room_m` to spare; its `joint` leads nearer as it grows."""
    far, near = -0.3, 0.3
    for _ in range(40):
        middle = (far + near) / 2
        there = here | {moved: here[moved] + one_joint(moved, joint, middle)}
        if ORACLE.between_robots_and_structure(there).distance_m > STOP_M + room_m:
            far = middle
        else:
            near = middle
    return here[moved] + one_joint(moved, joint, far)


def above_the_floor(room_m):
    low = HOME | {"fr": HOME["fr"] + one_joint("fr", 1, np.deg2rad(21.0) - HOME["fr"][1])}
    return with_room(room_m, "fr", low, 1)
