"""Whatever reaches the guarded realm's ends, in any order, nothing is raised, and what goes out is valid."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_cell import small_cell

from deltaq_cell.cell_model import CellModel
from deltaq_cell.identity import content_identity
from deltaq_cell.load import load_cell
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.guarded import Admission, Command, Plan, Request, ServerState, Supervision
from deltaq_protocol.messages import Message, Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.sim.core import Sim

# a service runs on where numpy warns of an overflow
pytestmark = [pytest.mark.filterwarnings("ignore::RuntimeWarning"), pytest.mark.long]

ROBOTS = st.sampled_from(["fr", "gr", "ghost"])
NUMBERS = st.integers(0, 8) | st.sampled_from([2**31, 2**63 - 1])
REALS = st.floats(-3, 3) | st.sampled_from([0.0, -0.0, 1e-308, 5e-324, 1e6, -1e6])
JOINTS = (
    st.sampled_from([6, 6, 9, 1, 32]).flatmap(lambda n: st.lists(REALS, min_size=n, max_size=n)).map(tuple)
)
CELLS = st.sampled_from(
    [str(content_identity(load_cell("lab"))), str(content_identity(small_cell())), "", "lab 0", " - \0"]
)
PHASES, REASONS = st.sampled_from(list(Phase)), st.none() | st.sampled_from(list(ReasonCode))
OUTPUTS = st.dictionaries(st.text(max_size=3) | st.just("gripper"), st.booleans(), max_size=2)


@st.composite
def states(draw: st.DrawFn) -> ServerState:
    """States of a robot with any number of joints, the same everywhere."""
    n = draw(st.sampled_from([6, 6, 9, 9, 1, 32]))
    joints = st.lists(REALS, min_size=n, max_size=n).map(tuple)
    plans = st.builds(Plan, dq=joints, brake_cycles=st.integers(1, 10_000), step=NUMBERS)
    return draw(
        st.builds(
            ServerState,
            robot=ROBOTS,
            cycle=NUMBERS,
            ipoc=NUMBERS,
            time_s=REALS,
            q=joints,
            q_cmd=joints,
            dq=joints,
            plan=plans,
            epoch=NUMBERS,
            sequence=NUMBERS,
            phase=PHASES,
            reason=REASONS,
            resets=NUMBERS,
            outputs=OUTPUTS,
            cell=CELLS,
        )
    )


REQUESTS = st.builds(
    Request,
    robot=ROBOTS,
    cycle=NUMBERS,
    lease_epoch=NUMBERS.filter(lambda epoch: epoch < 2**62),
    seq=NUMBERS,
    dq=st.none() | JOINTS,
)
COMMANDS = st.builds(
    Command, id=NUMBERS, kind=st.sampled_from(["stop", "reset", "io"]), robot=st.none() | ROBOTS, outputs=OUTPUTS
)  # fmt: skip
ADMISSIONS = st.builds(
    Admission, robot=ROBOTS, epoch=NUMBERS, sequence=NUMBERS, cycle=NUMBERS, follows_sequence=NUMBERS,
    follows_q_cmd=JOINTS, follows_dq=JOINTS, dq=JOINTS, brake_cycles=st.integers(1, 10_000),
)  # fmt: skip
SUPERVISIONS = st.builds(
    Supervision,
    robot=ROBOTS,
    epoch=NUMBERS,
    cycle=NUMBERS,
    stop=REASONS,
    resets=NUMBERS,
    outputs=OUTPUTS,
    cell=CELLS,
)
lasting = settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(scope="module")
def lab() -> CellModel:
    return CellModel.load("lab")


@lasting
@given(messages=st.lists(states() | REQUESTS | COMMANDS, max_size=12))
def test_the_gate_takes_whatever_is_a_message_and_says_nothing_but_messages(
    lab: CellModel, messages: list[Message]
) -> None:
    sim = Sim(lab, epoch=1)
    for message in messages:
        for output in sim.take(unpack(type(message), pack(message))):
            assert unpack(output.topic.message, pack(output.message)) == output.message
    sim.nearest()


@lasting
@given(orders=st.lists(st.tuples(st.none() | ADMISSIONS, st.none() | SUPERVISIONS), max_size=12))
def test_a_robot_server_takes_whatever_is_a_message_and_never_leaves_its_limits(
    orders: list[tuple[Admission | None, Supervision | None]],
) -> None:
    cell = small_cell()
    server, robot = RobotServer(cell, "fr", process=1), cell.robots["fr"]
    for number, (admission, supervision) in enumerate(orders):
        q = robot.home
        measured = Measurement(ipoc=12 * number, q=q, q_start=q if number == 0 else None)
        q_cmd = server.cycle(measured, 0.012 * number, admission, supervision)
        assert (robot.lower <= q_cmd).all()
        assert (q_cmd <= robot.upper).all()
        assert server.state is not None
        assert unpack(ServerState, pack(server.state)) == server.state
