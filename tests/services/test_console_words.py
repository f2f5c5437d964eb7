"""What the console says of a robot whose controller sees badly."""

import pytest

from deltaq_protocol.messages import Phase, RobotState, Sight, ToolPose
from deltaq_services.console.messages import phase_words

POSE = ToolPose(position=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("sight", "said"),
    [
        (None, "engaged"),
        (Sight.FRESH, "engaged"),
        (Sight.STALE, "engaged, and its view of the leader is stale (view_stale)"),
        (Sight.LOST, "engaged, and its view of the leader is lost (view_lost)"),
        (Sight.HIDDEN, "engaged, and a body hides its camera's target (view_hidden)"),
        (
            Sight.OUT_OF_REACH,
            "engaged, and limits or bodies keep its camera from the view asked for (view_out_of_reach)",
        ),
    ],
)
def test_a_stale_lost_or_hidden_view_is_shown_beside_the_phase(sight: Sight | None, said: str) -> None:
    told = {"robot": "fr", "cycle": 1, "ipoc": 4, "time_s": 0.0, "q": (0.0,), "q_cmd": (0.0,), "tool": POSE}
    state = RobotState.model_validate({**told, "phase": Phase.ENGAGED, "sight": sight})
    assert phase_words(state, is_stale=False) == (said, "")
