"""Emulated drives whose joints lag differently, each a real `Servo` of its own."""

import numpy as np

from deltaq_emulator.drives import Servo


class SpreadServo:
    """The drives of one robot, as `Servo` has them: a joint's dead time is longer the further out the joint is.

    Attributes:
        spread_s: by how much the last joint lags more than the first.
    """

    spread_s = 0.0

    def __init__(self, q, lag, cycle_s):
        later_s = np.linspace(0.0, self.spread_s, len(q))
        lags = [lag.model_copy(update={"dead_time_s": lag.dead_time_s + later}) for later in later_s]
        self.servos = [Servo(np.array([place]), each, cycle_s) for place, each in zip(q, lags, strict=True)]

    @property
    def q(self):
        return np.array([servo.q[0] for servo in self.servos])

    @property
    def dq_dt(self):
        return np.array([servo.dq_dt[0] for servo in self.servos])

    def advance(self, setpoint):
        for servo, value in zip(self.servos, setpoint, strict=True):
            servo.advance(np.array([value]))
