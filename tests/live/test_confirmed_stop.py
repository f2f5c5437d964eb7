"""A stop and a reset over zenoh: what is answered is what the robots have shown."""

from __future__ import annotations

from pathlib import Path

import pytest
from live_stack import live_stack

from deltaq_launch.cell_connection import connect
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode

pytestmark = pytest.mark.live


def test_done_is_what_robots_have_shown_and_a_robot_that_is_gone_is_not_said_to_be_stopped(
    tmp_path: Path,
) -> None:
    with live_stack(tmp_path, moving=True) as stack, connect(stack.cell, "test") as running:
        assert running.stop().what == "stop"
        assert {robot.phase for robot in running.status().robots.values()} == {Phase.HELD}
        stack.wait_until_at_rest()
        stack.reset()
        gate = running.status().gate
        assert "command_stale_epoch" not in gate
        assert "command_replayed_sequence" not in gate
        running.reset("gr")
        stack.wait_until_moving()
        stack.kill("robot-server-gr")
        with pytest.raises(RefusedError, match=r"not confirmed: .* that every robot is held") as refused:
            running.stop()
        assert refused.value.code is ReasonCode.UNREACHABLE
        stack.wait_until_at_rest()
        assert running.status().robots["fr"].phase is Phase.HELD
