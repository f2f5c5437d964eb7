"""A stop and a reset over zenoh: what is answered is what the robots have shown."""

import pytest
from shared_cell import SharedStack

from deltaq_deploy.launch.cell_connection import connect
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode

pytestmark = pytest.mark.live


def test_a_stop_is_confirmed_by_measured_rest_and_never_for_a_lost_robot(
    moving_stack: SharedStack,
) -> None:
    stack = moving_stack
    with connect(stack.cell, "test") as running:
        before = running.status().gate
        assert running.stop().what == "stop"
        assert {robot.phase for robot in running.status().robots.values()} == {Phase.HELD}
        stack.wait_until_at_rest()
        stack.reset()
        gate = running.status().gate
        for refused in ("command_stale_epoch", "command_replayed_sequence"):
            assert gate.get(refused, 0) == before.get(refused, 0)
        running.reset("gr")
        stack.wait_until_moving()
        stack.kill("robot-server-gr")
        with pytest.raises(RefusedError, match=r"not confirmed: .* that every robot is held") as refused:
            running.stop()
        assert refused.value.code is ReasonCode.UNREACHABLE
        stack.wait_until_at_rest()
        assert running.status().robots["fr"].phase is Phase.HELD
