"""When a robot counts as standing, so that its services may be ended."""

import pytest

from deltaq_deploy.launch.bring_to_rest import rests
from deltaq_protocol.messages import LeaseStatus, Phase, RobotStatus
from deltaq_protocol.reasons import ReasonCode


def status(phase, cycle=1, q=0.5, reason=None):
    return RobotStatus(
        phase=phase, reason=reason, cycle=cycle, state_age_s=0.0, q=(q,), lease=LeaseStatus(), counters={}
    )


def test_a_held_robot_that_still_brakes_does_not_rest():
    assert not rests(status(Phase.HELD, 1, 0.5), status(Phase.HELD, 5, 0.6))


def test_a_held_robot_at_one_place_in_two_cycles_rests():
    assert rests(status(Phase.HELD, 1), status(Phase.HELD, 5))


def test_one_observation_does_not_prove_rest():
    assert not rests(None, status(Phase.HELD))
    assert not rests(status(Phase.HELD, 5), status(Phase.HELD, 5))


@pytest.mark.parametrize("phase", [Phase.READY, Phase.ENGAGED, Phase.BRAKING])
def test_a_robot_that_is_not_held_does_not_rest(phase):
    assert not rests(status(phase, 1), status(phase, 5))


def test_a_silent_robot_is_not_waited_for():
    assert rests(None, status(Phase.OFFLINE))
    assert rests(None, status(Phase.HELD, reason=ReasonCode.KRC_LOST))
