"""The lag of moving axes: measured among noise, losses and stops, and never too long where the gate is right."""

import numpy as np
import pytest
from remembered import remembered

from deltaq_cell.description import ServoLag
from deltaq_cell.drive_lag import modelled_lag
from deltaq_cell.load import load_cell
from deltaq_emulator.servo import Servo
from deltaq_services.robot_server.lag_watch import LagWatch

LAB, LAB_4MS = load_cell("lab"), load_cell("lab-4ms")
QUICK = ServoLag(dead_time_s=0.012, natural_frequency_rad_s=167.0)
SLOW = ServoLag(dead_time_s=0.058, natural_frequency_rad_s=40.0)
SWINGING = ServoLag(dead_time_s=0.058, natural_frequency_rad_s=40.0, damping=0.5)


class Arm:
    """A robot on drives of some lag, that is driven about at random and stopped now and then."""

    def __init__(self, cell, lag, presumed_s, probed=None, seed=0):
        robot, self.cycle_s = cell.robots["fr"], cell.cycle_s
        self.random = np.random.default_rng(seed)
        told = None if probed is None else modelled_lag(probed, cell.cycle_s)
        self.watch = LagWatch(robot, cell.cycle_s, presumed_s, robot.home, (told,) * 6)
        self.servo = Servo(robot.home, lag, cell.cycle_s)
        self.setpoint, self.speed = robot.home.copy(), np.zeros(6)
        self.krc = self.setpoint
        self.max_speed, self.max_dv = robot.max_velocity, robot.max_acceleration * cell.cycle_s
        self.target, self.ipoc, self.missed = np.zeros(6), 2**32 - 500, False
        self.longest_s = 0.0

    def run(self, seconds, loss="", moves=True):
        for _ in range(round(seconds / self.cycle_s)):
            self.cycle(loss, moves)
        return self.watch

    def cycle(self, loss, moves):
        if self.random.random() < 1.4 * self.cycle_s:
            share = self.random.choice([0.0, 0.05, 0.3, 1.0])
            self.target = moves * share * self.random.uniform(-1, 1, 6) * self.max_speed
        self.ipoc = (self.ipoc + round(1000 * self.cycle_s)) % 2**32
        lost = self.random.random() < 0.05
        if not (lost and loss == "telegram"):
            if not self.missed:
                self.speed = self.speed + np.clip(self.target - self.speed, -self.max_dv, self.max_dv)
                self.setpoint = self.setpoint + self.speed * self.cycle_s
            noise = 3e-6 * self.random.uniform(-1, 1, 6)
            self.watch.cycle(np.round(self.servo.q + noise, 6), self.ipoc, self.missed, self.setpoint)
            self.missed = lost and loss == "reply"
            if not self.missed:
                self.krc = self.setpoint
        self.servo.advance(self.krc)
        self.longest_s = max([self.longest_s, *(lag_s for lag_s in self.watch.lag_s() if lag_s is not None)])


@pytest.mark.parametrize("loss", ["", "telegram", "reply"])
@pytest.mark.parametrize("cell", [LAB, LAB_4MS])
@pytest.mark.parametrize("lag", [QUICK, SLOW, SWINGING])
def test_no_lag_is_taken_to_be_longer_than_it_is_in_motion_and_stops_and_with_losses(cell, lag, loss):
    true_s = modelled_lag(lag, cell.cycle_s).settled_s
    arm = Arm(cell, lag, presumed_s=true_s, probed=lag)
    assert arm.run(8.0, loss).fault == ""
    assert true_s - 0.002 < arm.longest_s < true_s + 0.012
    np.testing.assert_allclose(arm.watch.lag_s(), true_s, atol=0.02)


@pytest.mark.parametrize("cell", [LAB, LAB_4MS])
def test_drives_that_lag_more_than_their_probe_showed_are_found_out_within_two_seconds(cell):
    arm = Arm(cell, SLOW, presumed_s=0.072, probed=QUICK, seed=1)
    assert arm.run(1.0, moves=False).fault == ""  # nothing is known of a robot at rest
    assert arm.run(2.0).fault.startswith("axis a")
    assert ", the gate presumes 72: set gate.servo_lag_s to at least 0.1" in arm.watch.fault


def test_where_the_probe_told_nothing_the_mean_delay_of_a_moving_axis_is_told():
    arm = Arm(LAB, SLOW, presumed_s=0.204)
    assert arm.watch.lag_s() == (None,) * 6
    known = [lag_s for lag_s in arm.run(4.0).lag_s() if lag_s is not None]
    assert len(known) >= 3
    assert known == pytest.approx([0.12] * len(known), abs=0.01)


def test_another_that_takes_its_place_goes_on_as_it_would():
    arm = Arm(LAB, SLOW, presumed_s=0.072, probed=QUICK)
    for _ in range(30):
        arm.run(0.1, "reply")
        heir = Arm(LAB, SLOW, presumed_s=0.072, probed=QUICK).watch
        heir.restore(arm.watch.snapshot())
        arm.watch, one = heir, arm.watch
        assert remembered(heir) == remembered(one)
        assert (heir.lag_s(), heir.fault) == (one.lag_s(), one.fault)
    assert arm.watch.fault
