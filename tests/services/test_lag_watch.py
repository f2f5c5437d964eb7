"""The lag of moving axes: measured among noise, losses and stops, and never too long where the gate is right."""

import numpy as np
import pytest

from deltaq_cell.description import ServoLag
from deltaq_cell.drive_lag import modelled_lag
from deltaq_cell.load import load_cell
from deltaq_emulator.drives import Servo
from deltaq_services.robot_server.lag_watch import LagWatch

LAB, LAB_4MS = load_cell("lab"), load_cell("lab-4ms")
QUICK = ServoLag(dead_time_s=0.012, natural_frequency_rad_s=167.0)
SLOW = ServoLag(dead_time_s=0.058, natural_frequency_rad_s=40.0)
MEANS_S, DAMPINGS = (0.12, 0.026, 0.048, 0.072, 0.156), (0.5, 0.6, 0.7, 1.0)


def drives(mean_s, damping, cycle_s):
    """Drives that lag by so much in the mean, 50 ms of it response where there is room."""
    response_s = min(0.05, mean_s - cycle_s - 0.002)
    dead_s = mean_s - cycle_s - response_s
    return ServoLag(dead_time_s=dead_s, natural_frequency_rad_s=2 * damping / response_s, damping=damping)


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


@pytest.mark.by_day(24)
@pytest.mark.parametrize("loss", ["", "telegram", "reply"])
@pytest.mark.parametrize("cell", [LAB, LAB_4MS])
@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("mean_s", MEANS_S)
def test_the_lag_is_never_overestimated_in_motion_at_stops_or_with_losses(mean_s, damping, cell, loss):
    lag = drives(mean_s, damping, cell.cycle_s)
    true_s = modelled_lag(lag, cell.cycle_s).settled_s
    arm = Arm(cell, lag, presumed_s=true_s, probed=lag)
    assert arm.run(4.0, loss).fault == ""
    assert true_s - 0.002 < arm.longest_s < true_s + 0.006
    np.testing.assert_allclose(arm.watch.lag_s(), true_s, atol=0.006)


@pytest.mark.by_day(8)
@pytest.mark.parametrize("cell", [LAB, LAB_4MS])
@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("mean_s", MEANS_S)
def test_oscillation_at_the_frequency_of_the_drives_is_not_taken_for_lag(mean_s, damping, cell):
    lag = drives(mean_s, damping, cell.cycle_s)
    told = modelled_lag(lag, cell.cycle_s)
    robot = cell.robots["fr"]
    for frequency_rad_s in (10.0, 20.0, 30.0):
        setpoint, servo = robot.home.copy(), Servo(robot.home, lag, cell.cycle_s)
        watch = LagWatch(robot, cell.cycle_s, told.settled_s, robot.home, (told,) * 6)
        for cycle in range(round(2.0 / cell.cycle_s)):
            watch.cycle(np.round(servo.q, 6), round(1000 * cell.cycle_s) * cycle, False, setpoint)
            servo.advance(setpoint)
            setpoint = setpoint + 0.5 * np.sin(frequency_rad_s * cycle * cell.cycle_s) * cell.cycle_s
            assert max(watch.lag_s()) < told.settled_s + 0.006
        assert watch.fault == ""


@pytest.mark.parametrize("cell", [LAB, LAB_4MS])
def test_drives_lagging_more_than_their_probe_are_detected_within_two_seconds(cell):
    arm = Arm(cell, SLOW, presumed_s=0.072, probed=QUICK, seed=1)
    assert arm.run(1.0, moves=False).fault == ""  # nothing is known of a robot at rest
    assert arm.run(2.0).fault.startswith("axis a")
    assert ", the gate presumes 72: set gate.servo_lag_s to at least 0.1" in arm.watch.fault


def test_without_a_probed_lag_the_mean_delay_of_a_moving_axis_is_reported():
    arm = Arm(LAB, SLOW, presumed_s=0.204)
    assert arm.watch.lag_s() == (None,) * 6
    known = [lag_s for lag_s in arm.run(4.0).lag_s() if lag_s is not None]
    assert len(known) >= 3
    assert known == pytest.approx([0.12] * len(known), abs=0.01)
