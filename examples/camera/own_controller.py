# /// script
# requires-python = ">=3.11"
# dependencies = ["deltaq[all]"]
# ///
"""From a pan-tilt error to a camera controller of one's own, run through the gate in virtual time."""

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.interface import LastIncrement, View
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_controllers.limits import IncrementLimits
from deltaq_experiments.options import Options
from deltaq_experiments.virtual import record


class PanTilt:
    """Turns the camera of `robot` towards the tool of `leader`; nothing more."""

    def __init__(self, robot, leader, cycle_s):
        self.robot, self.leader = robot, leader
        self.limits = IncrementLimits.of(robot, cycle_s)
        self.last = LastIncrement(self.limits.max_ddq)

    def error(self, q, q_leader):
        """Pan and tilt, in the picture: the focus' direction in camera axes, its first two components."""
        T, p = self.robot.camera_pose(q), self.leader.forward(q_leader)[:3, 3]
        to_focus = p - T[:3, 3]
        u = to_focus / np.linalg.norm(to_focus)
        return (T[:3, :3].T @ u)[:2], u, np.linalg.norm(to_focus), T[:3, :3]

    def increment(self, view: View):
        """One increment (n,) for what is seen [rad]."""
        q, dq_last = view.own.q_cmd, self.last.update(view.own)
        y, u, d, R = self.error(q, view.others["gr"].q)
        J = self.robot.jacobian(q, "camera")
        # u' = -(I - u u^T) J_v q' / d, and the camera that sees it turns with J_w q'
        turning = np.cross(np.eye(3), u) @ J[3:]
        moving = (np.eye(3) - np.outer(u, u)) @ J[:3] / d
        J_t = (R.T @ (turning - moving))[:2]
        dq = -0.3 * np.linalg.pinv(J_t, rcond=0.02) @ y
        return self.limits.admissible(dq, q, dq_last)


cell = CellModel.load("lab")
robot, leader = cell.robots["fr"], cell.robots["gr"]
controller = PanTilt(robot, leader, cell.description.cycle_s)
run = record(Options(duration_s=4), controller, ScriptedLeader(leader, cell.description.cycle_s))

q, q_leader = run.trace.q["fr"], run.trace.q["gr"]
angles = np.degrees([np.linalg.norm(controller.error(*pair)[0]) for pair in zip(q, q_leader, strict=True)])
print(f"view angle error: largest {angles.max():.2f} deg, last {angles[-1]:.2f} deg")
print(f"the gate admitted {run.gate.admitted}, scaled {run.gate.scaled}, held {run.gate.held}")
