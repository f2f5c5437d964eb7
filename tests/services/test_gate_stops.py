"""A controller that means harm: every drive at full speed is stopped short, and may retreat.

The whole stack runs in virtual time; an oracle that shares no bound with the gate judges the emulated
controllers' own records.
"""

import math

import numpy as np
import pytest
import yaml
from spread_drives import SpreadServo

from deltaq_cell.description import ServoLag
from deltaq_cell.drive_lag import modelled_lag
from deltaq_emulator import drives
from deltaq_protocol.messages import Outcome
from deltaq_testing.oracle import ClearanceOracle, limit_violations
from deltaq_testing.virtual_cell.cell import VirtualCell

pytestmark = pytest.mark.long
CYCLE_S = 0.012


@pytest.fixture(scope="module")
def oracle():
    return ClearanceOracle(VirtualCell("lab").cell)


class Attack:
    """Drives FR with one request after the other and keeps what the emulated controllers did."""

    def __init__(self, oracle, cell="lab"):
        self.stack = VirtualCell(cell)
        self.stack.run_until_ready()
        self.stack.acquire("fr", "attacker")
        self.fr = self.stack.cell.robots["fr"]
        self.full_speed = self.fr.max_velocity * self.stack.cell.description.cycle_s
        self.oracle = oracle
        self.setpoints = []
        self.least = np.inf
        self.verdicts = []

    def drive(self, request, cycles):
        """`request` is an increment (6,), or a function that gives one."""
        for _ in range(cycles):
            self.stack.cycle()
            dq = request() if callable(request) else request
            self.verdicts.append(self.stack.ask("fr", dq))
            self.setpoints.append(self.stack.arms["fr"].krc.sample.q_setpoint)
            actual = {name: arm.q for name, arm in self.stack.arms.items()}
            self.least = min(self.least, self.oracle.between_robots_and_structure(actual).distance_m)

    def q(self):
        return self.stack.arms["fr"].q

    def violations(self):
        cycle_s = self.stack.cell.description.cycle_s
        return limit_violations(self.fr, np.array(self.setpoints), cycle_s)

    def clearance_m(self, q):
        others = {"gr": self.stack.arms["gr"].q}
        return self.oracle.between_robots_and_structure(others | {"fr": q}).distance_m

    def away(self):
        """A tenth of full speed along the steepest way out."""
        q = np.array(self.stack.states["fr"].q_cmd)
        steps = 1e-4 * np.eye(6)
        steepest = np.array([self.clearance_m(q + step) - self.clearance_m(q - step) for step in steps])
        return 0.1 * steepest / np.max(np.abs(steepest) / self.full_speed)

    def towards(self, point):
        """Full speed of the tool towards a point of the world."""

        def request():
            q = np.array(self.stack.states["fr"].q_cmd)
            J = self.fr.jacobian(q)[:3]
            direction = np.asarray(point) - self.fr.forward(q)[:3, 3]
            dq = J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(3), direction)
            return dq / np.max(np.abs(dq) / self.full_speed)

        return request


@pytest.mark.by_day(1)
@pytest.mark.parametrize(
    ("joint", "sign"),
    [
        *((joint, (-1) ** joint) for joint in range(6)),
        *(pytest.param(joint, -((-1) ** joint), marks=pytest.mark.nightly) for joint in range(6)),
    ],
)
def test_full_speed_at_a_joint_limit_ends_inside_it_and_retreats(oracle, joint, sign):
    attack = Attack(oracle)
    request = np.zeros(6)
    request[joint] = sign * attack.full_speed[joint]
    attack.drive(request, 260)
    assert attack.violations().total == 0
    assert attack.least >= 0.05
    assert attack.verdicts[-1].outcome is Outcome.HELD
    stopped = attack.q()[joint]
    attack.drive(-request * 0.2, 20)
    assert sign * (stopped - attack.q()[joint]) > np.deg2rad(1)
    assert attack.violations().total == 0


def test_full_speed_at_the_floor_is_stopped_short_and_retreats(oracle):
    attack = Attack(oracle)
    attack.drive(attack.towards((-1.0, -0.2, -1.0)), 150)
    assert_stopped_short_and_retreats(attack)


def test_full_speed_at_the_other_robot_is_stopped_short_and_retreats(oracle):
    attack = Attack(oracle)
    gr = attack.stack.cell.robots["gr"]
    attack.drive(attack.towards(gr.forward(gr.home)[:3, 3]), 150)
    assert_stopped_short_and_retreats(attack)


LAGS = [(mean_s, damping) for mean_s in (0.048, 0.072, 0.096, 0.12, 0.156) for damping in (1.0, 0.7, 0.5)]
"""Mean lag of the slowest joint, from sending to measuring, and damping; 50 ms of it are response [s]."""


def lagging_cell(folder, mean_s, damping, spread_s):
    """The lab cell on drives of that lag, with a gate that presumes what they do."""
    response_s = min(0.05, mean_s - 2 * CYCLE_S)
    dead_s = mean_s - 2 * CYCLE_S - response_s
    lag = ServoLag(dead_time_s=dead_s, natural_frequency_rad_s=2 * damping / response_s, damping=damping)
    settled_s = modelled_lag(lag, CYCLE_S).settled_s + spread_s
    presumed_s = CYCLE_S * (2 + math.ceil(settled_s / CYCLE_S))  # as measured, to a cycle, and one more
    gate = {"servo_lag_s": presumed_s, "servo_lag_spread_s": max(spread_s, 0.012)}
    robots = {name: {"servo_lag": lag.model_dump()} for name in ("fr", "gr")}
    file = folder / "lagging.yaml"
    file.write_text(yaml.safe_dump({"extends": "lab", "gate": gate, "robots": robots}), encoding="utf-8")
    return file


@pytest.mark.by_day(1)
@pytest.mark.parametrize("spread_s", [0.036, 0.0, 0.012, 0.024])
@pytest.mark.parametrize(("mean_s", "damping"), [(0.12, 1.0), *(lag for lag in LAGS if lag != (0.12, 1.0))])
def test_drives_within_the_presumed_lag_and_spread_keep_the_stop_distance_or_are_held(
    oracle, tmp_path, monkeypatch, mean_s, damping, spread_s
):
    """Full speed at the other robot; drives that swing out by more than the tolerance are held, and keep it too."""
    monkeypatch.setattr(SpreadServo, "spread_s", spread_s)
    monkeypatch.setattr(drives, "Servo", SpreadServo)
    attack = Attack(oracle, lagging_cell(tmp_path, mean_s, damping, spread_s))
    gr = attack.stack.cell.robots["gr"]
    attack.drive(attack.towards(gr.forward(gr.home)[:3, 3]), 150)
    assert Outcome.SCALED in {verdict.outcome for verdict in attack.verdicts}
    assert attack.least >= 0.05 - 1e-4
    assert attack.violations().total == 0


def test_full_speed_at_a_pipe_is_stopped_short_and_retreats(oracle):
    attack = Attack(oracle)
    pipes = [body for body in attack.stack.cell.structure if "pipe" in body.name]
    lens = attack.fr.forward(attack.fr.home)[:3, 3]
    nearest = min(pipes, key=lambda pipe: np.linalg.norm(pipe.placement.translation - lens))
    attack.drive(attack.towards(nearest.placement.translation), 150)
    assert_stopped_short_and_retreats(attack)


def assert_stopped_short_and_retreats(attack):
    last = attack.verdicts[-1]
    assert last.outcome is not Outcome.ADMITTED
    assert last.reasons[0].code in ("clearance", "position_limit")
    assert attack.least >= 0.05
    if last.reasons[0].code == "clearance":
        assert attack.least < 0.05 + 0.02  # and not timid: it comes within 2 cm of the stop distance
    assert attack.violations().total == 0
    if last.reasons[0].code == "clearance":
        stopped_m = attack.clearance_m(attack.q())
        before = len(attack.verdicts)
        attack.drive(attack.away, 60)
        outcomes = [verdict.outcome for verdict in attack.verdicts[before:]]
        # at the boundary a tube that bends may need more room than there is: it brakes until the drives, which lag,
        # have left the way there, and goes on
        gate = attack.stack.cell.description.gate
        assert outcomes.count(Outcome.HELD) <= gate.servo_lag_s / CYCLE_S
        assert Outcome.REFUSED not in outcomes
        assert attack.clearance_m(attack.q()) > stopped_m + 0.01
    assert attack.least >= 0.05
    assert attack.violations().total == 0
