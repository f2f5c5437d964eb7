"""Messages of the guarded realm."""

import pytest
from small_cell import server_state

from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.guarded import Plan, ServerState


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"q_cmd": (0.0,)}, "q_cmd has 1 joints, q has 6"),
        ({"dq": (0.0,) * 7}, "dq has 7 joints, q has 6"),
        ({"plan": Plan(dq=(0.0,) * 9, brake_cycles=1, step=0)}, "plan.dq has 9 joints, q has 6"),
    ],
)
def test_a_state_whose_joints_are_not_the_same_everywhere_is_no_message(changes, told):
    state = server_state()
    assert unpack(ServerState, pack(state)) == state
    with pytest.raises(InvalidMessageError, match=told):
        unpack(ServerState, pack(state.model_copy(update=changes)))
