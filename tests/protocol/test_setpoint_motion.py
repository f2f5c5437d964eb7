"""The motion of one robot from cycle to cycle, which gate and Robot Server compute alike."""

from dataclasses import replace

import numpy as np
import pytest
from small_cell import server_state

from deltaq_protocol.guarded import Admission, Plan
from deltaq_protocol.setpoint_motion import SetpointMotion

HERE, DQ = np.array([0.5, -0.25]), np.array([0.25, -0.5])
AT_REST = SetpointMotion.at_rest(HERE, sequence=4)


def admission(**changes):
    fields = {
        "robot": "fr",
        "epoch": 1,
        "sequence": 5,
        "cycle": 20,
        "follows_sequence": 4,
        "follows_q_cmd": (0.5, -0.25),
        "follows_dq": (0.0, 0.0),
        "dq": (0.25, -0.5),
        "brake_cycles": 2,
    }
    return Admission(**fields | changes)


def test_a_robot_at_rest_stays_in_place_every_cycle():
    assert AT_REST.rests
    assert AT_REST.braked() == AT_REST
    assert AT_REST.plan == Plan(dq=(0.0, 0.0), brake_cycles=1, step=1)
    np.testing.assert_array_equal(AT_REST.brake(), np.zeros(2))
    assert SetpointMotion.at_rest(HERE).sequence == 0


def test_an_admission_is_sent_unchanged_and_followed_by_its_brake_to_rest():
    moved = AT_REST.admitted(admission())
    assert (moved.sequence, moved.rests) == (5, False)
    assert moved.plan == Plan(dq=(0.25, -0.5), brake_cycles=2, step=0)
    np.testing.assert_array_equal([moved.dq, moved.q_cmd], [DQ, HERE + DQ])
    np.testing.assert_array_equal(moved.brake(), DQ / 2)
    braking = moved.braked()
    assert (braking.sequence, braking.step, braking.rests) == (5, 1, False)
    np.testing.assert_array_equal([braking.dq, braking.q_cmd], [DQ / 2, HERE + 1.5 * DQ])
    assert braking.braked() == SetpointMotion.at_rest(HERE + 1.5 * DQ, sequence=5)


def test_a_motion_is_restored_from_its_state():
    plan = Plan(dq=(0.25, -0.5), brake_cycles=2, step=0)
    state = server_state(q=(9.0, 9.0), q_cmd=(0.75, -0.75), dq=(0.25, -0.5), plan=plan, sequence=5)
    assert SetpointMotion.of(state) == AT_REST.admitted(admission())


@pytest.mark.parametrize(
    "changes",
    [
        {"follows_sequence": 3},
        {"follows_q_cmd": (0.5, np.nextafter(-0.25, 0))},
        {"follows_dq": (0.0, 1e-300)},
    ],
)
def test_an_admission_matches_a_motion_only_bit_for_bit(changes):
    assert AT_REST.leads_to(admission())
    assert not AT_REST.leads_to(admission(**changes))


@pytest.mark.parametrize(
    "changes",
    [
        {"q_cmd": HERE + 1e-12},
        {"dq": DQ},
        {"plan_dq": DQ},
        {"brake_cycles": 2},
        {"step": 2},
        {"sequence": 5},
    ],
)
def test_motions_are_equal_if_all_their_values_are(changes):
    alike = replace(AT_REST, q_cmd=HERE.copy())
    assert alike == AT_REST
    assert hash(alike) == hash(AT_REST)
    other = replace(AT_REST, **changes)
    assert other != AT_REST
    assert len({AT_REST, alike, other}) == 2
    assert AT_REST != "a motion"
