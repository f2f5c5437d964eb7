"""The lag that `deltaq krc lag` reads from a robot's states."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from deltaq_cell.description import ServoLag
from deltaq_cell.drive_lag import modelled_lag
from deltaq_cell.load import load_cell
from deltaq_deploy.rsi.lag_sweep import DrivenSweep, measured_axis, motions
from deltaq_emulator.drives import Servo

GR, FR = (load_cell("lab").robots[name] for name in ("gr", "fr"))
SWINGING = ServoLag(dead_time_s=0.058, natural_frequency_rad_s=40.0, damping=0.5)


def courses_of(robot, lag, cycle_s, lost=(), stuck=()):
    """What a robot on drives of that lag shows of a measurement, by axis; some states are lost on their way."""
    servo, setpoint, cycle = Servo(robot.home, lag, cycle_s), robot.home.copy(), 0
    scale = np.where(np.array(robot.units) == "m", 1e3, math.degrees(1.0))
    courses = {}
    for motion in motions(robot, robot.home, cycle_s):
        states = []
        for number, increment in enumerate((0.0, *motion.increments)):
            cycle += 1
            q = np.round(servo.q * scale, 4) / scale
            q[list(stuck)] = robot.home[list(stuck)]
            setpoint = setpoint.copy()
            setpoint[motion.axis] += increment
            if number == 0 or cycle % 50 not in lost:
                states.append(SimpleNamespace(cycle=cycle, q=q, q_cmd=setpoint))
            servo.advance(setpoint)
        courses.setdefault(motion.axis, []).append(DrivenSweep.of(motion, states))
    np.testing.assert_allclose(setpoint, robot.home, atol=1e-9)
    return courses


@pytest.mark.parametrize(
    ("robot", "cycle_s", "lost"), [(GR, 0.012, ()), (FR, 0.012, (7, 23)), (FR, 0.004, ())]
)
@pytest.mark.parametrize("lag", [ServoLag(), SWINGING])
def test_the_sweep_measures_the_lag_of_each_axis(robot, cycle_s, lost, lag):
    true = modelled_lag(lag, cycle_s)
    for courses in courses_of(robot, lag, cycle_s, lost).values():
        measured = measured_axis(courses, cycle_s)
        assert measured.moving_s == pytest.approx(true.mean_s, abs=0.004)
        for name, within_s in (("dead_s", 0.014), ("half_s", 0.004), ("settled_s", 0.01)):
            assert getattr(measured.lag, name) == pytest.approx(getattr(true, name), abs=within_s)
        assert measured.lag.overshoot == pytest.approx(true.overshoot, abs=0.02)


def test_an_axis_that_does_not_follow_is_reported_with_its_motion():
    courses = courses_of(FR, ServoLag(), 0.012, stuck=[2])
    measured_axis(courses[1], 0.012)
    with pytest.raises(ValueError, match=r"it moved by 0\.000000 instead of 0\.005933"):
        measured_axis(courses[2], 0.012)


def test_motions_keep_a_share_of_the_limits_and_start_towards_the_middle_of_the_range():
    for motion in motions(FR, FR.upper, 0.012):
        speed = np.abs(motion.increments).max() / 0.012
        assert speed <= 0.45 * FR.max_velocity[motion.axis]
        assert motion.is_step or speed <= 0.1 * FR.max_velocity[motion.axis] * (1 + 1e-9)
        most = 0.5 * FR.max_acceleration[motion.axis] * 0.012**2
        assert np.abs(np.diff(motion.increments, prepend=0.0)).max() <= most * (1 + 1e-9)
    assert next(motions(FR, FR.upper, 0.012)).increments.sum() < 0
    assert next(motions(FR, FR.lower, 0.012)).increments.sum() > 0
