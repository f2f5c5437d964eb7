"""Controllers that turn the first axis of the floor robot by 20 degrees in a second."""

import math

TURN_RAD = math.radians(20)
STEP_RAD = TURN_RAD * 0.012
GOAL = (TURN_RAD, 0.0, 0.0, 0.0, 0.0, 0.0)
"""From home [rad]."""


def goal_of(cell):
    return cell.model.robots["fr"].home + GOAL


class Ramp:
    """Sends the increments of a plan, whether they arrive or not."""

    def __init__(self):
        self.began_s = None

    def __call__(self, state):
        self.began_s = state.time_s if self.began_s is None else self.began_s
        return [STEP_RAD if state.time_s - self.began_s < 1.0 else 0.0, 0, 0, 0, 0, 0]


class ClosedRamp(Ramp):
    """Sends what is missing to the plan."""

    def __init__(self):
        super().__init__()
        self.start = None

    def __call__(self, state):
        self.began_s = state.time_s if self.began_s is None else self.began_s
        self.start = state.q_cmd[0] if self.start is None else self.start
        planned = self.start + TURN_RAD * min(state.time_s - self.began_s, 1.0)
        missing = planned - state.q_cmd[0]
        return [max(-2 * STEP_RAD, min(2 * STEP_RAD, missing)), 0, 0, 0, 0, 0]
