"""The Robot Server's core: the last program before the drives."""

import numpy as np
import pytest

from deltaq_cell.load import load_cell
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.guarded import Admission, Supervision
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.robot_server.core import Measurement, RobotServer

CELL = load_cell("lab")
FR = CELL.robots["fr"]
EPOCH = 7
STEP = FR.max_acceleration * CELL.cycle_s**2
REST = np.zeros(6)


class Rig:
    """A Robot Server whose robot is always where it was sent."""

    def __init__(self):
        self.server = RobotServer(CELL, "fr")
        self.q = FR.home.copy()
        self.ipoc = 1000
        self.resets = 0
        self.cycle(q_start=self.q)

    def cycle(self, admission=None, gate=True, stop=None, epoch=EPOCH, q_start=None, missed_last=False):
        self.ipoc += 12
        supervision = Supervision(robot="fr", epoch=epoch, cycle=0, stop=stop, resets=self.resets)
        measured = Measurement(self.ipoc, self.q, q_start=q_start, missed_last=missed_last)
        self.q = self.server.cycle(measured, self.ipoc / 1000, admission, supervision if gate else None)
        return self.server.state

    def admission(self, increment, **changes):
        state = self.server.state
        fields = {
            "robot": "fr",
            "epoch": EPOCH,
            "sequence": state.sequence + 1,
            "cycle": state.cycle,
            "follows_sequence": state.sequence,
            "follows_q_cmd": state.q_cmd,
            "follows_dq": state.dq,
            "dq": tuple(np.asarray(increment).tolist()),
            "brake_cycles": brake_cycles(np.asarray(increment), STEP),
        }
        return Admission(**(fields | changes))

    def run_up(self, cycles):
        """Accelerate all joints for some cycles."""
        for count in range(1, cycles + 1):
            assert self.cycle(self.admission(count * STEP)).phase is Phase.ENGAGED

    @property
    def counters(self):
        return self.server.counters


@pytest.fixture
def rig():
    return Rig()


def test_it_is_offline_until_the_gate_is_heard():
    server = RobotServer(CELL, "fr")
    server.cycle(Measurement(12, FR.home, q_start=FR.home), 0.0)
    assert server.state.phase is Phase.OFFLINE


def test_without_admission_the_setpoint_stands_still(rig):
    for _ in range(5):
        state = rig.cycle()
    assert state.q_cmd == tuple(FR.home.tolist())
    assert state.phase is Phase.READY


def test_an_admission_is_sent_to_the_bit_and_engages(rig):
    dq = STEP * 0.5
    state = rig.cycle(rig.admission(dq))
    assert state.phase is Phase.ENGAGED
    assert state.q_cmd == tuple((FR.home + dq).tolist())
    assert state.sequence == 1


def test_starved_it_drives_the_brake_and_is_ready_again(rig):
    rig.run_up(5)
    speeds = [np.array(rig.server.state.dq)]
    phases = []
    while np.any(speeds[-1]):
        state = rig.cycle()
        speeds.append(np.array(state.dq))
        phases.append(state.phase)
    assert phases[0] is Phase.BRAKING
    assert rig.cycle().phase is Phase.READY
    assert len(speeds) == 6
    assert np.all(np.abs(np.diff(speeds, axis=0)) <= STEP * (1 + 1e-6))


@pytest.mark.parametrize(
    ("changes", "counter"),
    [
        ({"epoch": 8}, "admission_wrong_epoch"),
        ({"cycle": 0}, "admission_late"),
        ({"sequence": 0}, "admission_replayed"),
        ({"follows_sequence": 3}, "admission_unchained"),
        ({"follows_q_cmd": tuple((FR.home + 1e-12).tolist())}, "admission_unchained"),
        ({"follows_dq": (1e-12,) * 6}, "admission_unchained"),
        ({"dq": (0.0,) * 7}, "admission_wrong_shape"),
        ({"dq": tuple((FR.max_velocity * CELL.cycle_s * 1.01).tolist())}, "admission_too_fast"),
        ({"dq": tuple((STEP * 1.01).tolist())}, "admission_too_abrupt"),
    ],
)
def test_a_wrong_admission_is_counted_and_not_taken(rig, changes, counter):
    state = rig.cycle(rig.admission(STEP * 0.5, **changes))
    assert rig.counters[counter] == 1
    assert state.q_cmd == tuple(FR.home.tolist())
    assert state.phase is Phase.READY


def test_a_brake_that_is_too_short_is_not_taken(rig):
    rig.run_up(3)
    rig.cycle(rig.admission(3.5 * STEP, brake_cycles=3))
    assert rig.counters["admission_brake_too_abrupt"] == 1
    assert rig.server.state.phase is Phase.BRAKING


def test_a_brake_that_ends_outside_the_limits_is_not_taken(rig):
    q_edge = FR.upper - STEP * 0.5
    rig.cycle(q_start=q_edge)
    rig.resets += 1
    rig.cycle()
    rig.cycle(rig.admission(STEP))
    assert rig.counters["admission_leaves_limits"] == 1


def test_outside_its_limits_it_may_come_back_but_not_go_further(rig):
    rig.cycle(q_start=FR.upper + 0.1)
    rig.resets += 1
    rig.cycle()
    rig.cycle(rig.admission(STEP * 0.1))
    assert rig.counters["admission_leaves_limits"] == 1
    assert rig.cycle(rig.admission(-STEP * 0.1)).phase is Phase.ENGAGED


def test_an_admission_a_cycle_late_costs_a_dip_in_speed_and_no_jump(rig):
    rig.run_up(4)
    late = rig.admission(4 * STEP)
    before = np.array(rig.cycle().dq)
    state = rig.cycle(late)
    assert rig.counters["admission_late"] == 1
    assert np.all(np.abs(np.array(state.dq) - before) <= STEP * (1 + 1e-6))


def test_a_silent_gate_latches_held_until_a_reset(rig):
    rig.run_up(3)
    for _ in range(60):
        state = rig.cycle(gate=False)
    assert (state.phase, state.reason) == (Phase.HELD, ReasonCode.GATE_LOST)
    assert rig.cycle().phase is Phase.HELD
    rig.resets += 1
    assert rig.cycle().phase is Phase.READY
    assert rig.server.state.reason is None


def test_a_new_gate_is_not_obeyed_before_a_reset(rig):
    state = rig.cycle(epoch=8)
    assert (state.phase, state.reason) == (Phase.HELD, ReasonCode.GATE_LOST)
    rig.resets += 1
    state = rig.cycle(epoch=8)
    assert (state.phase, state.epoch) == (Phase.READY, 8)


def test_a_stop_brakes_along_the_certified_brake_and_holds(rig):
    rig.run_up(5)
    state = rig.cycle(rig.admission(5 * STEP), stop=ReasonCode.OPERATOR_STOP)
    assert state.phase is Phase.HELD
    np.testing.assert_allclose(state.dq, 4 * STEP)


def test_a_reset_waits_for_rest(rig):
    rig.run_up(5)
    rig.cycle(stop=ReasonCode.OPERATOR_STOP)
    rig.resets += 1
    phases = [rig.cycle().phase for _ in range(8)]
    assert phases[0] is Phase.HELD
    assert phases[-1] is Phase.READY


def test_a_missed_reply_is_sent_again_instead_of_a_double_step(rig):
    rig.run_up(5)
    before = rig.server.state
    state = rig.cycle(missed_last=True)
    assert state.q_cmd == before.q_cmd
    assert state.plan == before.plan
    assert rig.cycle(rig.admission(5 * STEP)).phase is Phase.ENGAGED


def test_replies_missed_for_long_hold_the_robot(rig):
    rig.run_up(5)
    for _ in range(30):
        state = rig.cycle(missed_last=True)
    assert (state.phase, state.reason) == (Phase.HELD, ReasonCode.KRC_LOST)


def test_a_silent_krc_holds_the_robot_where_the_krc_does(rig):
    rig.run_up(3)
    rig.server.krc_silent(99.0)
    assert (rig.server.state.phase, rig.server.state.reason) == (Phase.HELD, ReasonCode.KRC_LOST)
    stood = rig.server.state.q_cmd
    assert rig.cycle().q_cmd == stood  # and does not go on with a brake from rest


def test_a_new_session_starts_from_the_measured_place_at_rest(rig):
    rig.run_up(3)
    state = rig.cycle(q_start=FR.home)
    assert state.q_cmd == tuple(FR.home.tolist())
    assert not any(state.dq)
    assert state.reason is ReasonCode.KRC_LOST
